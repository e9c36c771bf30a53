//! Image and sparse depths to dense depth: the only place where bases and fit meet.

use crate::classic::Classic;
use crate::data::DepthMap;
use crate::error::{Error, Result};
use crate::fit::{Fit, FitConfig, fit, left_out};
use crate::model::{Bases, BasisNet, Normalisation, Plan, PlannedBases, Weights};
use crate::rng::hash;
use crate::sample::{Interpolation, Size, image_tensor, image_values, resize_rgb};
use crate::simd::Level;
use burn::tensor::Device;
use image::RgbImage;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::time::{Duration, Instant};

/// The weights that come with the program.
const EMBEDDED: &[u8] = include_bytes!("../assets/weights.safetensors");

/// The note of a weights file that holds its `FitConfig`.
pub const FIT_NOTE: &str = "fit";

/// Predictions stay within the sparse depths' range widened by this factor both ways. Relative to
/// the depths, so that scaling them scales the result.
pub const RANGE: f32 = 10.0;

/// A way to complete depth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Method {
    /// Base functions fitted to the points.
    Lsdc,
    /// A method without training.
    Classic(Classic),
}

impl Method {
    /// All methods.
    pub fn all() -> impl Iterator<Item = Self> {
        std::iter::once(Self::Lsdc).chain(Classic::ALL.map(Self::Classic))
    }

    /// The name on the command line and in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Lsdc => "lsdc",
            Self::Classic(classic) => classic.name(),
        }
    }
}

impl std::str::FromStr for Method {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        Self::all().find(|m| m.name() == name).ok_or_else(|| {
            let names: Vec<&str> = Self::all().map(Self::name).collect();
            Error::config(format!("unknown method `{name}`"))
                .hint(format!("methods: {}", names.join(", ")))
        })
    }
}

impl TryFrom<String> for Method {
    type Error = Error;

    fn try_from(name: String) -> Result<Self> {
        name.parse()
    }
}

impl From<Method> for String {
    fn from(method: Method) -> Self {
        method.name().to_owned()
    }
}

/// A trained network and a fit, ready to complete depth.
#[derive(Clone, Debug)]
pub struct Completer {
    engine: Engine,
    normalisation: Normalisation,
    fit: FitConfig,
}

/// What computes base functions.
#[derive(Clone, Debug)]
enum Engine {
    /// The network as it was trained, on any device.
    Net(Box<BasisNet>, Device),
    /// The network prepared for the CPU.
    Plan(Plan),
}

/// The base functions of an image, ready to be fitted to any points.
#[derive(Clone, Debug)]
pub struct ImageBases(Values);

#[derive(Clone, Debug)]
enum Values {
    Net(Box<Bases>),
    Plan(PlannedBases),
}

impl ImageBases {
    /// Values `[pixels, N + 1]` at pixels `y * width + x` of an output of `size` (height, width).
    pub fn at(&self, size: (usize, usize), pixels: &[u32]) -> Vec<f32> {
        match &self.0 {
            Values::Plan(bases) => bases.at(size, pixels),
            Values::Net(_) if pixels.is_empty() => Vec::new(),
            Values::Net(bases) => {
                let values = bases.at(size, &[pixels.to_vec()]).into_data();
                values.iter::<f32>().collect()
            }
        }
    }

    /// Bases x weights at every pixel of an output of `size` (height, width).
    pub fn combine(&self, size: (usize, usize), weights: &[f64]) -> Vec<f32> {
        match &self.0 {
            Values::Plan(bases) => bases.combine(size, weights),
            Values::Net(bases) => {
                let weights: Vec<f32> = weights.iter().map(|&w| w as f32).collect();
                bases.combine(size, &weights)
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
        let fit = match weights.record.notes.get(FIT_NOTE) {
            None => FitConfig::default(),
            Some(json) => serde_json::from_str(json).map_err(|e| {
                Error::weights("the `fit` record of the weights cannot be read").because(e)
            })?,
        };
        let net = weights.load(device)?;
        let plan = (*device == Device::flex()).then(|| Plan::new(&net, Level::here()));
        let completer = Self::new(net, weights.record.normalisation, fit, device);
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

    /// Changes the height and width down to whose number of pixels larger images are reduced
    /// before the network sees them.
    #[must_use]
    pub fn with_input(mut self, input: [usize; 2]) -> Self {
        self.normalisation.input = input;
        self
    }

    /// Completes `sparse` under the guidance of `rgb`, at `size` or the size of `rgb`.
    ///
    /// # Errors
    /// Image and sparse depths of different sizes, no point, or damaged weights.
    pub fn complete(
        &self,
        rgb: &RgbImage,
        sparse: &DepthMap,
        size: Option<Size>,
    ) -> Result<Completion> {
        check_sizes(rgb, sparse)?;
        let started = Instant::now();
        let bases = self.bases(rgb)?;
        let network = started.elapsed();
        let mut completion = self.complete_with(&bases, sparse, size)?;
        completion.timings.network = network;
        Ok(completion)
    }

    /// Completes `sparse` with base functions that were kept: new points for the same image cost
    /// only a fit. The result has `size` or the size of `sparse`.
    ///
    /// # Errors
    /// No point, or damaged weights.
    pub fn complete_with(
        &self,
        bases: &ImageBases,
        sparse: &DepthMap,
        size: Option<Size>,
    ) -> Result<Completion> {
        let started = Instant::now();
        // On a thread of the pool, which need not be awaited for each step.
        let (fit, reading) = rayon::scope(|_| {
            let (rows, depths) = at_points(bases, sparse);
            let reading = started.elapsed();
            fit(&rows, &depths, &self.fit).map(|fit| (fit, reading))
        })?;
        let fitting = started.elapsed();

        let started = Instant::now();
        let size = size.unwrap_or(Size {
            height: sparse.height(),
            width: sparse.width(),
        });
        let mut values = bases.combine((size.height, size.width), &fit.weights);
        let (low, high) = sparse.range().unwrap_or((0.0, 0.0));
        for value in &mut values {
            *value = value.clamp(low / RANGE, high * RANGE);
        }
        let depth = DepthMap::new(size.width, size.height, values)?;
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

    /// What the residual of each point would be, in metres and in the order of
    /// [`DepthMap::points`], had it been left out of the fit that `complete_with` or `fit` made of the
    /// same points: the error to expect where there is no point.
    ///
    /// # Errors
    /// Damaged weights.
    pub fn left_out(&self, bases: &ImageBases, sparse: &DepthMap, fit: &Fit) -> Result<Vec<f64>> {
        let (rows, _) = at_points(bases, sparse);
        left_out(&rows, fit, &self.fit)
    }

    /// Fits base functions to points, without a dense depth map.
    ///
    /// # Errors
    /// No point, or damaged weights.
    pub fn fit(&self, bases: &ImageBases, sparse: &DepthMap) -> Result<Fit> {
        let (rows, depths) = at_points(bases, sparse);
        fit(&rows, &depths, &self.fit)
    }

    /// The base functions of an image. A larger image than those of training is first reduced to
    /// their number of pixels; its base functions can be read at any size all the same.
    ///
    /// # Errors
    /// An image without pixels.
    pub fn bases(&self, rgb: &RgbImage) -> Result<ImageBases> {
        let [height, width] = self.normalisation.input;
        let (w, h) = (rgb.width() as f64, rgb.height() as f64);
        let scale = ((height * width) as f64 / (w * h)).sqrt().min(1.0);
        let reduced = |length: f64| ((length * scale).round() as usize).max(1);
        let size = Size {
            height: reduced(h),
            width: reduced(w),
        };
        let working = resize_rgb(rgb, size, Interpolation::PilBilinear)?;
        let Normalisation {
            mean, deviation, ..
        } = self.normalisation;
        Ok(ImageBases(match &self.engine {
            Engine::Net(net, device) => {
                let image = image_tensor(&[&working], mean, deviation, device)?;
                Values::Net(Box::new(net.bases(image)))
            }
            Engine::Plan(plan) => {
                let (width, height) = working.dimensions();
                let image = image_values(&working, mean, deviation);
                Values::Plan(plan.bases(&image, (height as usize, width as usize)))
            }
        }))
    }
}

/// Completes with a method that needs no training.
///
/// # Errors
/// Image and sparse depths of different sizes, or no point.
pub fn complete_classic(method: Classic, rgb: &RgbImage, sparse: &DepthMap) -> Result<DepthMap> {
    check_sizes(rgb, sparse)?;
    method.complete(rgb, sparse)
}

/// Base functions `[points, N + 1]` and depths at the points.
fn at_points(bases: &ImageBases, sparse: &DepthMap) -> (Vec<f32>, Vec<f32>) {
    let (pixels, depths): (Vec<u32>, Vec<f32>) = sparse
        .points()
        .map(|p| ((p.y * sparse.width() + p.x) as u32, p.depth))
        .unzip();
    let rows = bases.at((sparse.height(), sparse.width()), &pixels);
    (rows, depths)
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

/// A short name of the weights that [`open_weights`] would read: changes with every bit of them.
///
/// # Errors
/// A file that cannot be read.
pub fn weights_name(path: Option<&Path>) -> Result<String> {
    let Some(path) = path else {
        return Ok(format!("of the program, {:016x}", hash(&[EMBEDDED])));
    };
    let bytes = std::fs::read(path).map_err(|e| Error::read(path, e))?;
    Ok(format!("`{}`, {:016x}", path.display(), hash(&[&bytes])))
}

/// Weights from a file, or those that come with the program.
///
/// # Errors
/// A file that cannot be read or is no weights file.
pub fn open_weights(path: Option<&Path>) -> Result<Weights> {
    let Some(path) = path else {
        return Weights::from_bytes(EMBEDDED, "embedded weights");
    };
    let bytes = std::fs::read(path).map_err(|e| Error::read(path, e))?;
    Weights::from_bytes(&bytes, &path.display().to_string())
}
