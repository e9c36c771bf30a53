//! The network's output for one image, ready for any set of points.

mod complete;
mod variants;

use crate::bilinear::InterpolationWeights;
use crate::completer::{Completer, HeadPlace};
use crate::depth_guide::DepthGuide;
use crate::ensemble::{Quality, mirrored};
use crate::error::{Error, ImageError, Result};
use crate::field;
use crate::fit::{
    Affinities, BasisValues, CosineBasis, EvaluateBasis, FieldGeometry, FitMethod, FitPoints,
    ImageMoments, InlierPosterior, dot, inlier_posteriors,
};
use crate::image::Image;
use crate::network::{Basis, Forward, PATCH};
use crate::network_output::NetworkOutput;
use crate::observations::Observations;
use crate::resize::resized;
use crate::upsampling::Upsampling;
use crate::usable::UsableObservations;
use lsdc_kernels::clock::Instant;
use lsdc_kernels::schedule::{InTasks, join};
use rayon::prelude::*;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;

/// Largest number of points whose basis functions are in memory at once.
const MOST_EVALUATED: usize = 1 << 13;
/// Points per task.
const TOGETHER: usize = 1 << 7;

/// The basis functions and affinities of an image.
///
/// Holds everything that depends on the image alone, so that new points for the same image need only a fit. At
/// [`Quality::Best`], it also holds everything for the mirror image, and completions are the means of two fits.
/// Cheap to clone, and can be shared between threads.
#[derive(Clone)]
pub struct Scene(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    completer: Completer,
    forward: Arc<dyn Forward>,
    basis: Arc<dyn Basis>,
    /// The affinities: computed immediately for a fit with a field, otherwise on first use.
    affinities: Arc<OnceLock<Affinities>>,
    /// The same affinities, reduced at the steps of the depth guide.
    guided_affinities: OnceLock<Affinities>,
    /// Dense prediction of depth by other means; its functions are ordered between those of the network and the cosines.
    depth_guide: Option<DepthGuide>,
    cosines: CosineBasis,
    /// Height and width of the image.
    size: (usize, usize),
    /// Interpolation of depth from the grid of the field, in a fit with a field to a larger image.
    upsampling: Option<Arc<Upsampling>>,
    /// The last weights of which `combined` computed the map, and this map.
    combined: Mutex<Option<Combined>>,
    /// The scene of the mirror image, at [`Quality::Best`].
    mirror: Option<Scene>,
    network: Duration,
}

/// Weights, and the weighted sum of the functions at every pixel.
type Combined = (Vec<f64>, Arc<Vec<f32>>);

impl std::fmt::Debug for Scene {
    /// Omits the values, of which there are millions.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Scene")
            .field("width", &self.width())
            .field("height", &self.height())
            .finish_non_exhaustive()
    }
}

impl Completer {
    /// Runs the network on an image, and computes everything that depends on the image alone, including the guide predicted by
    /// a [depth head](Self::has_depth_head), if there is one.
    ///
    /// # Errors
    /// Colours that are not finite, settings that are out of range, or affinities of a damaged network.
    pub fn scene(&self, image: &Image<'_>) -> Result<Scene> {
        Scene::new(self.clone(), image, None, None)
    }

    /// Like [`Self::scene`], with a dense prediction of the depth of the image by other means, which may have another size.
    ///
    /// # Errors
    /// As for [`Self::scene`].
    ///
    /// ```
    /// # #[cfg(feature = "weights")]
    /// # fn main() -> lsdc_core::Result<()> {
    /// # use lsdc_core::{Channels, Completer, DepthGuide, GuideKind, Image, Observations, Weights};
    /// # let completer = Completer::new(&Weights::builtin_small())?;
    /// # let grey = vec![128_u8; 3 * 64 * 48];
    /// # let image = Image::new(64, 48, Channels::Rgb, &grey)?;
    /// // A ramp, in no unit; in truth, depth goes from 1 to 3 m.
    /// let ramp: Vec<f32> = (0..64 * 48).map(|i| 1.0 + (i % 64) as f32).collect();
    /// let guide = DepthGuide::new(GuideKind::Depth, 64, 48, &ramp)?;
    /// let mut points = Observations::new();
    /// for i in 0..30 {
    ///     let (u, v) = (37 * i % 64, 29 * i % 48);
    ///     points.add(f64::from(u), f64::from(v), 1.0 + 2.0 * u as f32 / 63.0);
    /// }
    /// let depth = completer.guided_scene(&image, &guide)?.complete(&points)?.depth()?;
    /// assert!((depth.at(31, 24) - 1.984).abs() < 0.1);
    /// # Ok(())
    /// # }
    /// # #[cfg(not(feature = "weights"))]
    /// # fn main() {}
    /// ```
    pub fn guided_scene(&self, image: &Image<'_>, guide: &DepthGuide) -> Result<Scene> {
        Scene::new(self.clone(), image, None, Some(guide.clone()))
    }
}

/// Returns the guide that the depth head of a completer predicts from the features of its network; `None` without a head, or if
/// the prediction is constant.
fn predicted_guide(completer: &Completer, forward: &dyn Forward) -> Result<Option<DepthGuide>> {
    let predicted = match completer.head() {
        HeadPlace::Nowhere => None,
        HeadPlace::Device => forward.published_depths(),
        HeadPlace::Cpu(head) => match forward.published_features() {
            None => None,
            Some(features) => {
                let size = (features.rows * PATCH, features.columns * PATCH);
                Some((head.predict(&features)?, size))
            }
        },
    };
    let Some((values, (height, width))) = predicted else {
        return Ok(None);
    };
    match DepthGuide::with_sky(width, height, &values) {
        Err(Error::Image(ImageError::NoGuide)) => Ok(None),
        guide => guide.map(Some),
    }
}

impl Scene {
    /// `output` is the output of the network at [`Quality::Standard`], if another program ran it.
    pub(crate) fn new(
        completer: Completer,
        image: &Image<'_>,
        output: Option<&NetworkOutput>,
        depth_guide: Option<DepthGuide>,
    ) -> Result<Self> {
        let started = Instant::now();
        completer.fit_config().check()?;
        let size = (image.height(), image.width());
        let rgb = image.rgb()?;
        let mirror = match completer.quality() {
            Quality::Standard => None,
            Quality::Best => {
                let rgb = mirrored(&rgb, size.1, 3);
                let guide = depth_guide.as_ref().map(DepthGuide::mirrored);
                let completer = completer.with_quality(Quality::Standard);
                let image = (rgb, size);
                Some(Self::of(completer, image, None, guide, None, started)?)
            }
        };
        Self::of(completer, (rgb, size), output, depth_guide, mirror, started)
    }

    /// Makes the scene of an image of this size (height, width). The run time of the network is measured from `started`, unless
    /// its `output` is given.
    fn of(
        completer: Completer,
        (rgb, (height, width)): (Vec<u8>, (usize, usize)),
        output: Option<&NetworkOutput>,
        depth_guide: Option<DepthGuide>,
        mirror: Option<Self>,
        started: Instant,
    ) -> Result<Self> {
        let normalisation = *completer.normalisation();
        let working = match output {
            Some(output) => output.size(),
            None => normalisation.working_size((height, width)),
        };
        let colours = resized(&rgb, (height, width), working)?;
        let fit_method = completer.fit_config().method;
        let has_field = fit_method.has_field();
        let forward: Box<dyn Forward> = if let Some(output) = output {
            Box::new(output.clone())
        } else {
            let values = normalised(&colours, normalisation.mean, normalisation.deviation);
            let network = completer.network();
            completer.run(|| network.forward(&values, working))?
        };
        // A field alone uses no guide.
        let predicts = depth_guide.is_none() && fit_method != FitMethod::Field;
        let predicted = || {
            if predicts {
                predicted_guide(&completer, &*forward)
            } else {
                Ok(None)
            }
        };
        // In parallel, because the layers of each are too small for many threads.
        let (basis, (affinities, predicted)) = completer.run(|| {
            join(
                || forward.basis(),
                || join(|| has_field.then(|| forward.affinities()), predicted),
            )
        });
        let depth_guide = depth_guide.or(predicted?);
        let affinities = affinities.map(|(values, size)| Affinities::new(size, &values));
        let affinities = affinities.transpose()?.map(OnceLock::from);
        let cosines = CosineBasis::up_to(completer.fit_config().cosines());
        let upsampling = has_field
            .then(|| Upsampling::new((rgb, (height, width)), (colours, working)))
            .flatten();
        let mut inner = Inner {
            completer,
            forward: forward.into(),
            basis: basis.into(),
            affinities: affinities.unwrap_or_default().into(),
            guided_affinities: OnceLock::new(),
            depth_guide,
            cosines,
            size: (height, width),
            upsampling: upsampling.map(Arc::new),
            combined: Mutex::default(),
            mirror,
            network: Duration::ZERO,
        };
        inner.needed_affinities()?;
        inner.network = started.elapsed();
        Ok(Self(Arc::new(inner)))
    }

    /// Number of columns of the image.
    pub fn width(&self) -> usize {
        self.0.size.1
    }

    /// Number of rows of the image.
    pub fn height(&self) -> usize {
        self.0.size.0
    }

    /// The run time of the network, including the mirror image at [`Quality::Best`].
    pub fn network_time(&self) -> Duration {
        self.0.network
    }

    /// Whether there is a guide, given or predicted by the [depth head](Completer::has_depth_head) of the network's encoder.
    pub fn is_guided(&self) -> bool {
        self.0.depth_guide.is_some()
    }

    /// The basis functions of the network, `[places, N + 1]`, at positions (u, v) of the image in pixels, where (0, 0) is the
    /// centre of the first pixel. The first function is the constant 1, or the map that replaces it in some weights.
    pub fn basis_functions(&self, places: &[[f64; 2]]) -> Vec<f32> {
        let inner = &*self.0;
        inner.completer.run(|| inner.basis.at(inner.size, places))
    }

    /// The statistics that a prior over weights is learned from.
    ///
    /// # Errors
    /// No usable observation, or a damaged network.
    #[doc(hidden)]
    pub fn moments(&self, observations: &Observations) -> Result<ImageMoments> {
        let inner = &*self.0;
        let usable = UsableObservations::new(observations, inner.size)?;
        let bases = inner.at(inner.size, &usable.places);
        Ok(ImageMoments::new(&inner.points(
            BasisValues::AtPoints(&bases),
            &usable,
            None,
            false,
        ))?)
    }

    /// The affinities of the image, if they were computed.
    pub(crate) fn known_affinities(&self) -> Option<&Affinities> {
        self.0.guided_affinities.get()
    }

    /// The guide.
    pub(crate) fn guide(&self) -> Option<&DepthGuide> {
        self.0.depth_guide.as_ref()
    }

    pub(crate) fn size(&self) -> (usize, usize) {
        self.0.size
    }

    pub(crate) fn completer(&self) -> &Completer {
        &self.0.completer
    }

    /// Returns basis functions, followed by cosines, at positions (u, v) of the image at `size` (height, width).
    pub(crate) fn at(&self, size: (usize, usize), places: &[[f64; 2]]) -> Vec<f32> {
        self.0.at(size, places)
    }

    /// Returns the interpolation of maps from the grid of the field, if the image is larger than this grid.
    pub(crate) fn upsampling(&self) -> Option<&Upsampling> {
        self.0.upsampling.as_deref()
    }

    /// Returns the pixels of the field of size `grid` (height, width) from which a position (u, v) of the image is
    /// interpolated.
    pub(crate) fn interpolation(
        &self,
        place: [f64; 2],
        grid: (usize, usize),
    ) -> InterpolationWeights {
        match self.upsampling() {
            Some(upsampling) => upsampling.interpolation(place, self.size()),
            None => InterpolationWeights::new(place, self.size(), grid),
        }
    }

    /// Returns the probability that each observation is an inlier, given its prediction from the others.
    pub(crate) fn inlier_posteriors(
        &self,
        usable: &UsableObservations,
    ) -> Result<Vec<InlierPosterior>> {
        let inner = &*self.0;
        let (config, prior) = (inner.completer.fit_config(), inner.completer.prior());
        inner.completer.run(|| {
            let rows = inner.bases_at_points(usable, true);
            let bases = rows
                .as_deref()
                .map_or(BasisValues::Everywhere(inner), |rows| {
                    BasisValues::Both(rows, inner)
                });
            let points = inner.points(bases, usable, inner.needed_affinities()?, false);
            inlier_posteriors(&points, config, prior)
        })
    }

    /// Returns the weighted sum of basis functions and cosines at every pixel of the image at `size` (height, width).
    pub(crate) fn combine(&self, size: (usize, usize), weights: &[f64]) -> Vec<f32> {
        self.0.map(size, weights)
    }
}

impl Inner {
    fn at(&self, size: (usize, usize), places: &[[f64; 2]]) -> Vec<f32> {
        match &self.upsampling {
            Some(upsampling) => self.read(upsampling, size, places),
            None => self.exactly_at(size, places),
        }
    }

    /// Interpolates the functions at each position from the pixels of the grid around it, like a map.
    fn read(&self, upsampling: &Upsampling, size: (usize, usize), places: &[[f64; 2]]) -> Vec<f32> {
        let interpolation = places
            .iter()
            .map(|&place| upsampling.interpolation(place, size));
        let interpolation: Vec<InterpolationWeights> = interpolation.collect();
        let around = interpolation.iter().flat_map(InterpolationWeights::iter);
        let mut pixels: Vec<u32> = around.map(|(pixel, _)| pixel).collect();
        pixels.sort_unstable();
        pixels.dedup();
        let width = upsampling.grid().1;
        let centre = |&pixel: &u32| [pixel as usize % width, pixel as usize / width];
        let centres: Vec<[f64; 2]> = pixels.iter().map(|p| centre(p).map(|v| v as f64)).collect();
        let functions = self.exactly_at(upsampling.grid(), &centres);
        let count = functions.len() / pixels.len().max(1);
        let mut rows = vec![0.0; places.len() * count];
        let parts = rows.par_chunks_mut((TOGETHER * count).max(1));
        let parts = parts.zip(interpolation.par_chunks(TOGETHER));
        parts.each(|(rows, interpolation)| {
            let pairs = rows.chunks_exact_mut(count).zip(interpolation);
            for (row, interpolation) in pairs {
                for (pixel, share) in interpolation.iter() {
                    let place = pixels.partition_point(|&other| other < pixel);
                    let functions = &functions[place * count..][..count];
                    let share = share as f32;
                    row.iter_mut()
                        .zip(functions)
                        .for_each(|(sum, function)| *sum += share * function);
                }
            }
        });
        rows
    }

    fn exactly_at(&self, size: (usize, usize), places: &[[f64; 2]]) -> Vec<f32> {
        let mut rows = self.basis.at(size, places);
        if let Some(guide) = self.depth_guide.as_ref().filter(|_| !places.is_empty()) {
            let before = rows.len() / places.len();
            let pairs = rows.chunks_exact(before);
            let more = guide.at(size, places);
            let pairs = pairs.zip(more.chunks_exact(guide.count()));
            rows = pairs.flat_map(|(own, more)| [own, more].concat()).collect();
        }
        if self.cosines.is_empty() || places.is_empty() {
            return rows;
        }
        let before = rows.len() / places.len();
        self.cosines.append_to(&rows, before, size, places)
    }

    fn combine(&self, size: (usize, usize), weights: &[f64]) -> Vec<f32> {
        let (others, smooth) = weights.split_at(weights.len().saturating_sub(self.cosines.len()));
        let (network, guides) = others.split_at(others.len().saturating_sub(self.guides()));
        let mut values = self.basis.combine(size, network);
        if let Some(guide) = &self.depth_guide {
            guide.add_to(size, guides, &mut values);
        }
        self.cosines.add_to(size, smooth, &mut values);
        values
    }

    /// Returns the number of functions of the guide.
    fn guides(&self) -> usize {
        self.depth_guide.as_ref().map_or(0, DepthGuide::count)
    }

    /// Returns the weighted sum on the grid of the field, cached: a fit with a field and its map use the same weights.
    fn combined(&self, weights: &[f64]) -> Arc<Vec<f32>> {
        let lock = || self.combined.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, map)) = lock().as_ref().filter(|(known, _)| known == weights) {
            return map.clone();
        }
        let map = Arc::new(self.combine(self.grid(), weights));
        *lock() = Some((weights.to_vec(), map.clone()));
        map
    }

    /// Returns the basis functions at the observations; `None` if the fit evaluates only a sample of them. The limit depends on
    /// whether the fit runs in `rounds`.
    fn bases_at_points(&self, usable: &UsableObservations, rounds: bool) -> Option<Vec<f32>> {
        let grid = self.grid();
        // If their sum at all points is interpolated from a map of the grid, a fit without rounds evaluates a sample.
        let is_read = self.upsampling.is_some() || self.pixels(&usable.places).is_some();
        let most = if rounds || !is_read {
            MOST_EVALUATED
        } else {
            field::MOST
        };
        // A fit to dense points also evaluates them in the holes between the points.
        let sparse = usable.places.len() <= most.min(grid.0 * grid.1 / 5);
        (!self.has_field() || sparse).then(|| self.at(self.size, &usable.places))
    }

    fn has_field(&self) -> bool {
        self.completer.fit_config().method.has_field()
    }

    /// Returns the height and width of the grid of the field.
    fn grid(&self) -> (usize, usize) {
        let upsampling = self.upsampling.as_ref();
        upsampling.map_or(self.size, |upsampling| upsampling.grid())
    }

    /// Returns the grid pixels at these positions, if the grid has the size of the image and every position is a pixel centre.
    fn pixels<'a>(&self, places: &'a [[f64; 2]]) -> Option<impl Iterator<Item = usize> + use<'a>> {
        let (height, width) = self.size;
        let centred = |&[u, v]: &[f64; 2]| {
            let is_centre = |place: f64, length: usize| {
                place.fract() == 0.0 && (0.0..length as f64).contains(&place)
            };
            is_centre(u, width) && is_centre(v, height)
        };
        let all = self.has_field() && self.upsampling.is_none() && places.iter().all(centred);
        let pixel = move |&[u, v]: &[f64; 2]| v as usize * width + u as usize;
        all.then(|| places.iter().map(pixel))
    }

    /// Returns the affinities, if the fit needs them.
    fn needed_affinities(&self) -> Result<Option<&Affinities>> {
        self.has_field().then(|| self.affinities()).transpose()
    }

    fn affinities(&self) -> Result<&Affinities> {
        if let Some(guided_affinities) = self.guided_affinities.get() {
            return Ok(guided_affinities);
        }
        let own = if let Some(own) = self.affinities.get() {
            own
        } else {
            let (values, size) = self.completer.run(|| self.forward.affinities());
            let found = Affinities::new(size, &values)?;
            self.affinities.get_or_init(|| found)
        };
        // A field alone uses no guide.
        let joint = self.completer.fit_config().method == FitMethod::Joint;
        let guided_affinities = match self.depth_guide.as_ref().filter(|_| joint) {
            None => own.clone(),
            Some(guide) => own.scaled_by(&guide.affinity_shares(own.size())),
        };
        Ok(self.guided_affinities.get_or_init(|| guided_affinities))
    }

    fn points<'a>(
        &'a self,
        bases: BasisValues<'a>,
        usable: &'a UsableObservations,
        affinities: Option<&'a Affinities>,
        transient: bool,
    ) -> FitPoints<'a> {
        let size = self.size;
        FitPoints {
            bases,
            guides: self.guides(),
            depths: usable.fitted(),
            deviations: usable.fitted_deviations(),
            places: Some(&usable.places),
            geometry: affinities.map(|affinities| FieldGeometry {
                affinities,
                size,
                upsampling: self.upsampling.as_deref(),
                transient,
            }),
        }
    }
}

impl EvaluateBasis for Inner {
    fn count(&self) -> usize {
        self.at(self.size, &[[0.0; 2]]).len()
    }

    fn at(&self, places: &[[f64; 2]]) -> Vec<f32> {
        self.at(self.size, places)
    }

    fn combine(&self, places: &[[f64; 2]], weights: &[f64]) -> Vec<f64> {
        if let Some(upsampling) = &self.upsampling {
            let map = self.combined(weights);
            let map: Vec<f64> = map.iter().copied().map(f64::from).collect();
            let parts: Vec<Vec<f64>> = places.par_chunks(TOGETHER).gather(|places| {
                let values = places.iter();
                values
                    .map(|&place| upsampling.interpolation(place, self.size).read(&map))
                    .collect()
            });
            return parts.concat();
        }
        if let Some(pixels) = self.pixels(places) {
            let map = self.combined(weights);
            return pixels.map(|pixel| f64::from(map[pixel])).collect();
        }
        let strips = places
            .par_chunks(MOST_EVALUATED / 8)
            .flat_map_iter(|places| {
                let rows = self.at(self.size, places);
                let rows = rows.chunks_exact(weights.len().max(1));
                rows.map(|row| dot(row, weights)).collect::<Vec<_>>()
            });
        strips.collect()
    }

    fn map(&self, grid: (usize, usize), weights: &[f64]) -> Vec<f32> {
        if self.grid() == grid && self.has_field() {
            self.combined(weights).to_vec()
        } else {
            self.combine(grid, weights)
        }
    }
}

/// Returns colours minus their mean, divided by their standard deviation.
pub(crate) fn normalised(rgb: &[u8], mean: [f32; 3], deviation: [f32; 3]) -> Vec<f32> {
    let tables: [[f32; 256]; 3] = std::array::from_fn(|c| {
        std::array::from_fn(|v| (v as f32 / 255.0 - mean[c]) / deviation[c])
    });
    let colours = rgb.iter().enumerate();
    colours.map(|(i, &v)| tables[i % 3][v as usize]).collect()
}
