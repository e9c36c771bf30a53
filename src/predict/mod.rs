//! Image and sparse depths to dense depth: the only place where bases and fit meet.

mod deviation;
mod method;
mod preserve;
mod weights;

pub use crate::classic::Classic;
pub use method::{Method, complete_classic};
pub use preserve::Preserve;
pub use weights::{
    Calibration, Embedded, embedded, open_weights, record_fit, record_prior, recorded_fit,
    recorded_prior, weights_hash, weights_name,
};

use crate::data::DepthMap;
use crate::error::{Error, Result};
use crate::fit::{
    Edges, Fit, FitConfig, FitMethod, ImageMoments, Points, Prior, Scene, Waves, fit,
};
use crate::model::{Bases, BasisNet, Normalisation, Plan, PlannedBases, Weights};
use crate::sample::{Interpolation, Size, image_tensor, image_values, resize_rgb};
use crate::simd::Level;
use burn::tensor::{Device, Tensor};
use image::RgbImage;
use std::path::Path;
use std::sync::OnceLock;
use std::time::{Duration, Instant};

/// Predictions stay within the sparse depths' range widened by this factor both ways. Relative to
/// the depths, so that scaling them scales the result.
pub const RANGE: f32 = 10.0;

/// How much closer to those of the frame before than to those of any image weights are expected, as a
/// ratio of variances.
const CLOSER: f64 = 10.0;

/// A trained network and a fit, ready to complete depth.
#[derive(Clone, Debug)]
pub struct Completer {
    engine: Engine,
    normalisation: Normalisation,
    fit: FitConfig,
    prior: Option<Prior>,
    /// Standard deviations as they come from the fit, times this are those of the errors.
    deviation: f64,
}

/// What computes base functions.
#[derive(Clone, Debug)]
enum Engine {
    /// The network as it was trained, on any device.
    Net(Box<BasisNet>, Device),
    /// The network prepared for the CPU.
    Plan(Plan),
}

/// The base functions of an image and the smooth ones that belong to none, ready to be fitted to any
/// points.
#[derive(Clone, Debug)]
pub struct ImageBases {
    values: Values,
    /// Computed at once for a fit with a field, else when first asked for.
    edges: OnceLock<Edges>,
    waves: Waves,
}

#[derive(Clone, Debug)]
enum Values {
    Net(Box<Unplanned>),
    Plan(PlannedBases),
}

/// What the plain network needs.
#[derive(Clone, Debug)]
struct Unplanned {
    bases: Bases,
    net: BasisNet,
    image: Tensor<4>,
}

impl ImageBases {
    /// Values `[pixels, N + 1 + waves]` at pixels `y * width + x` of an output of `size` (height,
    /// width).
    pub fn at(&self, size: (usize, usize), pixels: &[u32]) -> Vec<f32> {
        let rows = self.network_at(size, pixels);
        if self.waves.is_empty() || pixels.is_empty() {
            return rows;
        }
        self.waves
            .beside(&rows, rows.len() / pixels.len(), size, pixels)
    }

    /// Values `[pixels, N + 1]` of the constant and the functions of the network alone.
    pub fn network_at(&self, size: (usize, usize), pixels: &[u32]) -> Vec<f32> {
        match &self.values {
            Values::Plan(bases) => bases.at(size, pixels),
            Values::Net(_) if pixels.is_empty() => Vec::new(),
            Values::Net(net) => {
                let values = net.bases.at(size, &[pixels.to_vec()]).into_data();
                values.iter::<f32>().collect()
            }
        }
    }

    /// How strongly neighbouring pixels of the image are joined.
    pub fn edges(&self) -> &Edges {
        self.edges.get_or_init(|| match &self.values {
            Values::Plan(bases) => {
                let (strengths, size) = bases.edges();
                Edges::new(size, &strengths)
            }
            Values::Net(net) => {
                let strengths = net.net.edges(net.image.clone());
                let [_, height, width, _] = strengths.dims();
                let strengths: Vec<f32> = strengths.into_data().iter::<f32>().collect();
                Edges::new((height, width), &strengths)
            }
        })
    }

    /// Bases x weights at every pixel of an output of `size` (height, width).
    pub fn combine(&self, size: (usize, usize), weights: &[f64]) -> Vec<f32> {
        let (network, smooth) = weights.split_at(weights.len().saturating_sub(self.waves.len()));
        let mut values = self.network_combined(size, network);
        self.waves.add_to(size, smooth, &mut values);
        values
    }

    fn network_combined(&self, size: (usize, usize), weights: &[f64]) -> Vec<f32> {
        match &self.values {
            Values::Plan(bases) => bases.combine(size, weights),
            Values::Net(net) => {
                let weights: Vec<f32> = weights.iter().map(|&w| w as f32).collect();
                net.bases.combine(size, &weights)
            }
        }
    }
}

/// A dense depth map and how it came about.
#[derive(Clone, Debug)]
pub struct Completion {
    /// Metres, at the asked size.
    pub depth: DepthMap,
    /// The fit to the points.
    pub fit: Fit,
    /// Time spent on each stage.
    pub timings: Timings,
}

/// Wall-clock time of each stage.
#[derive(Clone, Copy, Debug)]
pub struct Timings {
    /// Image to features.
    pub network: Duration,
    /// Base functions at the points, and the solve.
    pub fit: Duration,
    /// The solve alone.
    pub solve: Duration,
    /// Base functions at every pixel, times weights.
    pub dense: Duration,
}

impl Completer {
    /// The weights that come with the program, on the CPU.
    ///
    /// # Errors
    /// None in a sound build.
    pub fn load() -> Result<Self> {
        Self::open(None, &Device::flex())
    }

    /// Weights from a file, or those that come with the program.
    ///
    /// # Errors
    /// A file that cannot be read or is no weights file.
    pub fn open(weights: Option<&Path>, device: &Device) -> Result<Self> {
        Self::with_weights(&open_weights(weights)?, device)
    }

    /// Uses the given weights with the fit that they were trained for.
    ///
    /// # Errors
    /// Weights that do not belong to their network.
    pub fn with_weights(weights: &Weights, device: &Device) -> Result<Self> {
        let fit = recorded_fit(weights)?.unwrap_or_default();
        let net = weights.load(device)?;
        let plan = (*device == Device::flex()).then(|| Plan::new(&net, Level::here()));
        let mut completer = Self::new(net, weights.record.normalisation, fit, device);
        if let Some((prior, calibration)) = recorded_prior(weights)? {
            completer = completer.with_prior(prior, calibration.deviation);
        }
        Ok(match plan.flatten() {
            None => completer,
            Some(plan) => Self {
                engine: Engine::Plan(plan),
                ..completer
            },
        })
    }

    /// Uses a network as it is: the plain reference of the prepared one.
    pub fn new(
        net: BasisNet,
        normalisation: Normalisation,
        fit: FitConfig,
        device: &Device,
    ) -> Self {
        Self {
            engine: Engine::Net(Box::new(net), device.clone()),
            normalisation,
            fit,
            prior: None,
            deviation: 1.0,
        }
    }

    /// Knows which weights are likely, and by what to multiply the standard deviations of pixels.
    #[must_use]
    pub fn with_prior(self, prior: Prior, deviation: f64) -> Self {
        Self {
            prior: Some(prior),
            deviation,
            ..self
        }
    }

    /// The settings of the fit.
    pub fn fit_config(&self) -> &FitConfig {
        &self.fit
    }

    /// Changes the settings of the fit.
    #[must_use]
    pub fn with_fit(mut self, fit: FitConfig) -> Self {
        self.fit = fit;
        self
    }

    /// Expects weights near those of another fit, up to their scale: for the next frame of a video.
    ///
    /// # Errors
    /// No prior, or weights of other base functions.
    pub fn after(&self, weights: &[f64]) -> Result<Self> {
        let prior = self.prior.as_ref().ok_or_else(|| {
            Error::config("without a learned prior there is nothing to draw towards another fit")
        })?;
        let mut next = self.clone();
        next.prior = Some(prior.about(weights)?);
        next.fit.lambda = self.fit.lambda.times(CLOSER);
        Ok(next)
    }

    /// Changes the height and width to whose number of pixels images are resized before the network
    /// sees them.
    #[must_use]
    pub fn with_input(mut self, input: [usize; 2]) -> Self {
        self.normalisation.input = input;
        self
    }

    /// Completes `sparse` under the guidance of `rgb`, at their size; [`Self::dense`] has any other.
    ///
    /// # Errors
    /// Image and sparse depths of different sizes, no point, or damaged weights.
    pub fn complete(&self, rgb: &RgbImage, sparse: &DepthMap) -> Result<Completion> {
        check_sizes(rgb, sparse)?;
        let started = Instant::now();
        let bases = self.bases(rgb)?;
        let network = started.elapsed();
        let mut completion = self.complete_with(&bases, sparse)?;
        completion.timings.network = network;
        Ok(completion)
    }

    /// Completes `sparse` with base functions that were kept: new points for the same image cost
    /// only a fit.
    ///
    /// # Errors
    /// No point, or damaged weights.
    pub fn complete_with(&self, bases: &ImageBases, sparse: &DepthMap) -> Result<Completion> {
        let started = Instant::now();
        // On a thread of the pool, which need not be awaited for each step.
        let (fit, reading) = rayon::scope(|_| {
            let gathered = Gathered::new(bases, sparse, None)?;
            let reading = started.elapsed();
            self.fit_gathered(bases, &gathered)
                .map(|fit| (fit, reading))
        })?;
        let fitting = started.elapsed();

        let started = Instant::now();
        let depth = self.dense(bases, &fit, sparse, None)?;
        Ok(Completion {
            depth,
            fit,
            timings: Timings {
                network: Duration::ZERO,
                fit: fitting,
                solve: fitting.saturating_sub(reading),
                dense: started.elapsed(),
            },
        })
    }

    /// Fits base functions to points, without a dense depth map. `deviations` has the standard
    /// deviation of each point in metres at its pixel.
    ///
    /// # Errors
    /// No point, deviations of another size or not one to a point, or damaged weights.
    pub fn fit(
        &self,
        bases: &ImageBases,
        sparse: &DepthMap,
        deviations: Option<&DepthMap>,
    ) -> Result<Fit> {
        self.fit_gathered(bases, &Gathered::new(bases, sparse, deviations)?)
    }

    fn fit_gathered(&self, bases: &ImageBases, gathered: &Gathered) -> Result<Fit> {
        let edges = (self.fit.method != FitMethod::Lse).then(|| bases.edges());
        fit(&gathered.points(edges), &self.fit, self.prior.as_ref())
    }

    /// The dense depth of a fit to `sparse`, at `size` or the size of `sparse`.
    ///
    /// # Errors
    /// An implausible size.
    pub fn dense(
        &self,
        bases: &ImageBases,
        fit: &Fit,
        sparse: &DepthMap,
        size: Option<Size>,
    ) -> Result<DepthMap> {
        let size = size.unwrap_or_else(|| size_of(sparse));
        let mut values = bases.combine((size.height, size.width), &fit.weights);
        if let Some(smooth) = fit.smooth() {
            smooth.add_to((size.height, size.width), &mut values);
        }
        let (low, high) = sparse.range().unwrap_or((0.0, 0.0));
        for value in &mut values {
            *value = (fit.space.depth(f64::from(*value)) as f32).clamp(low / RANGE, high * RANGE);
        }
        DepthMap::new(size.width, size.height, values)
    }

    /// What a prior over weights is learned from.
    ///
    /// # Errors
    /// No point, or damaged weights.
    pub fn moments(&self, bases: &ImageBases, sparse: &DepthMap) -> Result<ImageMoments> {
        ImageMoments::new(&Gathered::new(bases, sparse, None)?.points(None))
    }

    /// The leverage of each point, in the order of [`DepthMap::points`].
    pub fn leverages(&self, bases: &ImageBases, sparse: &DepthMap, fit: &Fit) -> Vec<f64> {
        let (places, _) = places(sparse);
        fit.leverages(&at_places(bases, sparse, &places))
    }

    /// The base functions of an image. An image of more or fewer pixels than those of training is
    /// first resized to their number: the network knows things at that size. Base functions can be
    /// read at any size all the same.
    ///
    /// # Errors
    /// An image without pixels.
    pub fn bases(&self, rgb: &RgbImage) -> Result<ImageBases> {
        let [height, width] = self.normalisation.input;
        let (w, h) = (rgb.width() as f64, rgb.height() as f64);
        let scale = ((height * width) as f64 / (w * h)).sqrt();
        let resized = |length: f64| ((length * scale).round() as usize).max(1);
        let size = Size {
            height: resized(h),
            width: resized(w),
        };
        let working = resize_rgb(rgb, size, Interpolation::PilBilinear)?;
        let Normalisation {
            mean, deviation, ..
        } = self.normalisation;
        let values = match &self.engine {
            Engine::Net(net, device) => {
                let image = image_tensor(&[&working], mean, deviation, device)?;
                Values::Net(Box::new(Unplanned {
                    bases: net.bases(image.clone()),
                    net: BasisNet::clone(net),
                    image,
                }))
            }
            Engine::Plan(plan) => {
                let (width, height) = working.dimensions();
                let image = image_values(&working, mean, deviation);
                Values::Plan(plan.bases(&image, (height as usize, width as usize)))
            }
        };
        let bases = ImageBases {
            values,
            edges: OnceLock::new(),
            waves: Waves::up_to(self.fit.waves()),
        };
        if self.fit.method != FitMethod::Lse {
            bases.edges();
        }
        Ok(bases)
    }
}

/// The points of a map with the base functions at them.
struct Gathered {
    bases: Vec<f32>,
    depths: Vec<f32>,
    deviations: Option<Vec<f32>>,
    places: Vec<[usize; 2]>,
    size: (usize, usize),
}

impl Gathered {
    fn new(bases: &ImageBases, sparse: &DepthMap, deviations: Option<&DepthMap>) -> Result<Self> {
        let (places, depths) = places(sparse);
        let deviations = deviations.map(|map| {
            let (size, other) = (size_of(sparse), size_of(map));
            if size == other {
                Ok(places
                    .iter()
                    .map(|&[x, y]| map.values()[y * map.width() + x])
                    .collect())
            } else {
                Err(Error::shape(format!(
                    "the sparse depths are {size} but their deviations are {other}"
                )))
            }
        });
        Ok(Self {
            bases: at_places(bases, sparse, &places),
            depths,
            deviations: deviations.transpose()?,
            places,
            size: (sparse.height(), sparse.width()),
        })
    }

    /// With the image's edges, if a fit needs them.
    fn points<'a>(&'a self, edges: Option<&'a Edges>) -> Points<'a> {
        let scene = |edges| Scene {
            edges,
            size: self.size,
        };
        Points {
            bases: &self.bases,
            depths: &self.depths,
            deviations: self.deviations.as_deref(),
            places: Some(&self.places),
            scene: edges.map(scene),
        }
    }
}

fn size_of(map: &DepthMap) -> Size {
    Size {
        height: map.height(),
        width: map.width(),
    }
}

/// The pixels (x, y) and depths of all points.
fn places(sparse: &DepthMap) -> (Vec<[usize; 2]>, Vec<f32>) {
    sparse.points().map(|p| ([p.x, p.y], p.depth)).unzip()
}

/// Base functions `[points, N + 1]` at the points of a map.
fn at_places(bases: &ImageBases, sparse: &DepthMap, places: &[[usize; 2]]) -> Vec<f32> {
    let pixel = |[x, y]: &[usize; 2]| (y * sparse.width() + x) as u32;
    let pixels: Vec<u32> = places.iter().map(pixel).collect();
    bases.at((sparse.height(), sparse.width()), &pixels)
}

/// Whether image and sparse depths show the same pixels.
///
/// # Errors
/// They differ in size.
pub fn check_sizes(rgb: &RgbImage, sparse: &DepthMap) -> Result<()> {
    if (rgb.width() as usize, rgb.height() as usize) == (sparse.width(), sparse.height()) {
        return Ok(());
    }
    Err(Error::shape(format!(
        "the image is {}x{} (width x height) but the sparse depths are {}x{}",
        rgb.width(),
        rgb.height(),
        sparse.width(),
        sparse.height()
    ))
    .hint(
        "both must show the same pixels; move the points to the image's size, do not interpolate",
    ))
}
