//! A fit and its results: depth at any position, residuals, outliers. Its standard deviations are in
//! `standard_deviation`.

use crate::detail::{Detail, PixelResiduals};
use crate::ensemble::{average, mirrored, mirrored_place};
use crate::error::{FitError, Result};
use crate::fit::{Fit, FitMethod, InlierPosterior, SmoothField, root_mean_square};
use crate::image::{check_rows, check_size};
use crate::lazy::get_or_compute;
use crate::limits::DepthLimits;
use crate::map::DepthMap;
use crate::scene::Scene;
use crate::upsampling::Upsampling;
use crate::usable::UsableObservations;
use rayon::prelude::*;
use std::borrow::Cow;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

/// A scene fitted to observations.
///
/// Everything beyond the fit is computed on request. Depths are measured along the optical axis, in the unit
/// of the observations.
///
/// At [`Quality::Best`](crate::Quality::Best) there are two fits, to the image and to its mirror image. Depths, residuals,
/// leave-one-out errors, standard deviations and weights of observations are means of both.
#[derive(Clone)]
pub struct Completion(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    scene: Scene,
    fit: Fit,
    usable: UsableObservations,
    /// Correction of the map by dense observations, if the image is larger than the field.
    detail: Option<Detail>,
    report: Report,
    leverages: OnceLock<Vec<f64>>,
    /// Fitted values at the pixels of the field, before they are converted to depths.
    values: OnceLock<Vec<f32>>,
    /// Completion of the mirror image, at [`Quality::Best`](crate::Quality::Best).
    mirror: Option<Completion>,
    /// Weights of the basis functions, followed by those of the mirror image.
    weights: Vec<f64>,
}

/// Statistics of a fit. At [`Quality::Best`](crate::Quality::Best), `residual` is computed from the mean of both fits,
/// `limited` is the larger of the two numbers, run times are sums, and all other values describe the fit to the original image.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Report {
    /// Number of observations given: `used + invalid + outside`.
    pub given: usize,
    /// Number of observations that were fitted.
    pub used: usize,
    /// Number of observations whose depth is not between 1e-15 and 1e15, or whose position is not finite.
    pub invalid: usize,
    /// Number of observations outside the image.
    pub outside: usize,
    /// Number of used observations without a valid standard deviation (missing, 0, negative or not finite) although other
    /// observations have one. Their standard deviation is taken to be that of the observations about the model of depth.
    pub without_deviation: usize,
    /// Number of used observations that were smoothed before the fit: each is replaced by the value of a plane through the
    /// nearby observations that agree with it. Smoothing requires dense observations with known standard deviations.
    pub smoothed: usize,
    /// Number of pixels of the field, in holes of dense depths, at which basis functions contradicted the surrounding depths
    /// and were limited.
    pub limited: usize,
    /// The model of depth.
    pub method: FitMethod,
    /// Root mean square of the residuals, in the unit of the observations.
    pub residual: f64,
    /// Number of directions that the observations determine, at most `functions`.
    pub rank: usize,
    /// Number of basis functions of the network, including the constant.
    pub functions: usize,
    /// Strength of the prior, if there is one: the ratio of the noise variance to the variance of the prior.
    pub lambda: Option<f64>,
    /// Trust in the [guide](crate::DepthGuide), if there was one: the expected size of the weights of its functions, in units
    /// of the scene's scale; 0 if the points do not support the guide.
    pub guide_trust: Option<f64>,
    /// Share of the median in the map: 0 is the joint fit of basis functions and field; 1 is the median of this fit, of the
    /// field alone, and of the surface spanned by the observations. With up to 1000 observations, it is chosen by their
    /// leave-one-out errors, and 0 if the joint fit predicts them best. `None` for other fits, and if the observations span no
    /// surface.
    pub median_share: Option<f64>,
    /// Run time of the network.
    pub network: Duration,
    /// Run time of the fit, including the evaluation of the basis functions at the observations, and `field`.
    pub fit: Duration,
    /// Run time of factorising the field of the image, in the first completion of a scene only.
    pub field: Duration,
    /// Run time of the solver alone.
    pub solve: Duration,
}

/// An observation that disagrees with the others.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Outlier {
    /// The index among the given observations.
    pub index: usize,
    /// The probability that it is an outlier.
    pub probability: f64,
    /// The distance from the value predicted by the other observations, in the local scale of the errors of inliers; positive
    /// where the observation is farther away.
    pub score: f64,
    /// Its depth minus the depth predicted by the other observations.
    pub error: f64,
    /// The weight of the observation in a robust fit.
    pub weight: f64,
}

impl std::fmt::Debug for Completion {
    /// Omits the values, of which there are millions.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Completion")
            .field("report", self.report())
            .finish_non_exhaustive()
    }
}

/// Returns the residuals of the map: those of the fit, unless observations were smoothed before it, or the map has detail.
fn residuals<'a>(
    fit: &'a Fit,
    usable: &UsableObservations,
    detail: Option<&Detail>,
) -> Cow<'a, [f64]> {
    if detail.is_none() && usable.smoothed.is_none() {
        return (&fit.residuals).into();
    }
    let pairs = fit.residuals.par_iter().zip(usable.fitted());
    let given = usable.depths.par_iter().zip(&usable.places);
    let left = pairs
        .zip(given)
        .map(|((residual, &fitted), (&given, &place))| {
            let depth = f64::from(fitted) - residual;
            let depth = detail.map_or(depth, |detail| detail.at(place, depth));
            f64::from(given) - depth
        });
    left.collect::<Vec<_>>().into()
}

impl Completion {
    pub(crate) fn new(
        scene: Scene,
        fit: Fit,
        usable: UsableObservations,
        method: FitMethod,
        [network, fitting, field, solve]: [Duration; 4],
        mirror: Option<Self>,
    ) -> Self {
        let detail = scene.upsampling().and_then(|upsampling| {
            let (places, depths) = (&usable.places, usable.fitted());
            scene.completer().run(|| {
                let pixel_residuals = PixelResiduals::new(
                    upsampling.size(),
                    places,
                    &fit.residuals,
                    &fit.point_weights,
                )?;
                Some(Detail::new(upsampling, pixel_residuals, places, depths))
            })
        });
        let mut residuals = residuals(&fit, &usable, detail.as_ref());
        let mut weights = fit.weights.clone();
        let mut both = [field, solve];
        let mut limited = fit.limited();
        if let Some(mirror) = &mirror {
            average(residuals.to_mut(), &mirror.own_residuals(), f64::midpoint);
            weights.extend_from_slice(mirror.weights());
            both[0] += mirror.report().field;
            both[1] += mirror.report().solve;
            limited = limited.max(mirror.report().limited);
        }
        let [field, solve] = both;
        let report = Report {
            given: usable.given,
            used: usable.indices.len(),
            invalid: usable.invalid,
            outside: usable.outside,
            without_deviation: usable.without_deviation,
            smoothed: usable
                .smoothed
                .as_ref()
                .map_or(0, |smoothed| smoothed.count),
            limited,
            method,
            residual: root_mean_square(&residuals),
            rank: fit.rank,
            functions: fit.functions(),
            lambda: fit.lambda,
            guide_trust: fit.guide_trust,
            median_share: fit.median_share(),
            network,
            fit: fitting,
            field,
            solve,
        };
        Self(Arc::new(Inner {
            scene,
            fit,
            usable,
            detail,
            report,
            leverages: OnceLock::new(),
            values: OnceLock::new(),
            mirror,
            weights,
        }))
    }

    /// Statistics of the fit.
    pub fn report(&self) -> &Report {
        &self.0.report
    }

    /// The dense depth at the size of the image.
    ///
    /// # Errors
    /// None for the image that the scene was made from.
    pub fn depth(&self) -> Result<DepthMap> {
        let (height, width) = self.0.scene.size();
        self.depth_at(width, height)
    }

    /// The dense depth at another size. In an image larger than the working size of the network, depth is interpolated at every
    /// pixel along the edges of the image (using the colours of the image at the same position); otherwise basis functions and
    /// field are evaluated at the requested resolution.
    ///
    /// # Errors
    /// An implausible size, or a network on a device that has failed.
    pub fn depth_at(&self, width: usize, height: usize) -> Result<DepthMap> {
        check_size(width, height)?;
        let values = self.averaged_map(width, |own| own.finite((height, width)))?;
        DepthMap::new(width, height, values)
    }

    /// Writes the dense depth into a buffer of the caller. Rows start `stride` values apart.
    ///
    /// # Errors
    /// An implausible size, rows that overlap, a buffer that is too short, or a network on a device that has failed; the
    /// buffer is then left unchanged.
    pub fn write_depth(
        &self,
        width: usize,
        height: usize,
        stride: usize,
        buffer: &mut [f32],
    ) -> Result<()> {
        check_size(width, height)?;
        check_rows(width, height, 1, stride, buffer.len())?;
        let values = self.averaged_map(width, |own| own.finite((height, width)))?;
        let rows = buffer.chunks_mut(stride).zip(values.chunks_exact(width));
        rows.for_each(|(row, values)| row[..width].copy_from_slice(values));
        Ok(())
    }

    /// The depth at positions (u, v) of the image in pixels, where (0, 0) is the centre of the first pixel.
    ///
    /// # Errors
    /// A position outside the image.
    pub fn at(&self, places: &[[f64; 2]]) -> Result<Vec<f32>> {
        let (height, width) = self.scene().size();
        let inside = |place: f64, length: usize| (-0.5..length as f64 - 0.5).contains(&place);
        let outside = places
            .iter()
            .find(|[u, v]| !(inside(*u, width) && inside(*v, height)));
        if let Some(&[u, v]) = outside {
            return Err(FitError::Outside {
                u,
                v,
                width,
                height,
            }
            .into());
        }
        let mut depths = self.own_depths(places);
        if let Some(mirror) = &self.0.mirror {
            let places = places.iter().map(|&place| mirrored_place(place, width));
            let others = mirror.own_depths(&places.collect::<Vec<_>>());
            average(&mut depths, &others, f32::midpoint);
        }
        Ok(depths)
    }

    /// The depths of this fit alone at positions within the image.
    fn own_depths(&self, places: &[[f64; 2]]) -> Vec<f32> {
        let Inner {
            scene, fit, detail, ..
        } = &*self.0;
        let rows = scene.completer().run(|| scene.at(scene.size(), places));
        let columns = rows.len() / places.len().max(1);
        let limits = self.depth_limits();
        let smooth_at =
            |smooth: &SmoothField, place| smooth.read(&scene.interpolation(place, smooth.size()));
        let value = |(row, &place): (&[f32], &[f64; 2])| {
            let functions = row.iter().zip(&fit.weights).map(|(b, w)| f64::from(*b) * w);
            let smooth = fit.smooth().map_or(0.0, |smooth| smooth_at(smooth, place));
            let depth = functions.sum::<f64>() + smooth;
            let depth = detail
                .as_ref()
                .map_or(depth, |detail| detail.at(place, depth));
            limits.apply(depth as f32)
        };
        rows.chunks_exact(columns.max(1))
            .zip(places)
            .map(value)
            .collect()
    }

    /// Returns a map with `width` columns: the map of this fit, or its mean with the map of the fit to the mirror image.
    pub(crate) fn averaged_map(
        &self,
        width: usize,
        own_map: impl Fn(&Self) -> Result<Vec<f32>>,
    ) -> Result<Vec<f32>> {
        let mut map = own_map(self)?;
        if let Some(mirror) = &self.0.mirror {
            let others = mirrored(&own_map(mirror)?, width, 1);
            average(&mut map, &others, f32::midpoint);
        }
        Ok(map)
    }

    /// Returns one value per given observation: that of this fit, or its mean with that of the fit to the mirror image; NaN for
    /// unused observations.
    fn averaged(&self, own: impl Fn(&Self) -> Vec<f64>) -> Vec<f64> {
        self.0.usable.scatter(&self.averaged_usable(own))
    }

    /// Like [`Self::averaged`], but for usable observations only.
    fn averaged_usable(&self, own: impl Fn(&Self) -> Vec<f64>) -> Vec<f64> {
        let mut values = own(self);
        if let Some(mirror) = &self.0.mirror {
            average(&mut values, &own(mirror), f64::midpoint);
        }
        values
    }

    /// The range of depths: that of the observations, widened by the factor [`RANGE`](crate::RANGE) at both ends. Nearer than
    /// 0.7 times the nearest observation, the fitted depth is continued linearly in inverse depth, where it would reach 0.
    pub fn limits(&self) -> (f32, f32) {
        let DepthLimits {
            lowest, highest, ..
        } = self.depth_limits();
        (lowest, highest)
    }

    pub(crate) fn depth_limits(&self) -> DepthLimits {
        DepthLimits::new(self.0.usable.range())
    }

    /// The number of pixels of a [map](Self::depth_at) of this completion whose depth differs from the fitted one, because that is
    /// far outside the range of the observations ([`Self::limits`]). At [`Quality::Best`](crate::Quality::Best), a pixel counts if
    /// it does in either fit.
    #[doc(hidden)]
    pub fn clamped_pixels(&self, map: &DepthMap) -> usize {
        let limits = self.depth_limits();
        let is_clamped = |depth: f32| limits.changed(depth);
        let Some(mirror) = &self.0.mirror else {
            let depths = map.values().iter();
            return depths.filter(|&&depth| is_clamped(depth)).count();
        };
        let size = (map.height(), map.width());
        let (own, others) = (self.dense(size), mirrored(&mirror.dense(size), size.1, 1));
        let pairs = own.into_iter().zip(others);
        pairs
            .filter(|&(own, other)| is_clamped(own) || is_clamped(other))
            .count()
    }

    /// Returns the dense depth of this fit alone, or an error if the device of the network has failed.
    fn finite(&self, size: (usize, usize)) -> Result<Vec<f32>> {
        let values = self.dense(size);
        if values.iter().any(|value| value.is_nan()) {
            return Err(FitError::NotFinite.into());
        }
        Ok(values)
    }

    /// Returns the dense depth of this fit alone; NaN if the device of the network has failed.
    pub(crate) fn dense(&self, size: (usize, usize)) -> Vec<f32> {
        let Inner { scene, detail, .. } = &*self.0;
        scene.completer().run(|| {
            let solved = scene.upsampling().map_or(size, Upsampling::grid);
            let mut values = match (self.solved(solved), scene.upsampling()) {
                (values, Some(upsampling)) => upsampling.enlarge(&values, size),
                (values, None) => values.into_owned(),
            };
            let limits = self.depth_limits();
            if let Some(detail) = detail {
                detail.add_to(size, &mut values);
            }
            let limited = |value: &mut f32| *value = limits.apply(*value);
            values.par_iter_mut().for_each(limited);
            values
        })
    }

    /// Returns the depths before clamping, at a size at which the equations hold. Depths at the pixels of the field are cached.
    fn solved(&self, size: (usize, usize)) -> Cow<'_, [f32]> {
        /// Largest number of pixels of a field whose values are cached.
        const MOST: usize = 1 << 18;
        let Inner {
            scene, fit, values, ..
        } = &*self.0;
        let is_field = fit.field_size() == Some(size) && size.0 * size.1 <= MOST;
        if let Some(values) = values.get().filter(|_| is_field) {
            return values.into();
        }
        let mut found = scene.combine(size, &fit.weights);
        if let Some(smooth) = fit.smooth() {
            smooth.add_to(size, &mut found);
        }
        if is_field {
            values.get_or_init(|| found).into()
        } else {
            found.into()
        }
    }

    /// For every given observation, its depth minus the fitted depth before clamping; NaN for unused observations.
    pub fn residuals(&self) -> Vec<f64> {
        self.averaged(|own| own.own_residuals().into_owned())
    }

    /// The residuals of the usable observations in this fit alone.
    fn own_residuals(&self) -> Cow<'_, [f64]> {
        let Inner {
            fit,
            usable,
            detail,
            ..
        } = &*self.0;
        residuals(fit, usable, detail.as_ref())
    }

    /// For every given observation, its depth minus the depth predicted by a fit to all other observations (the leave-one-out
    /// error, in closed form: Allen 1974); NaN for unused observations, and for observations that the fit interpolates exactly
    /// for any depths. The root mean square (the PRESS error) estimates the depth error at pixels without observations, if the
    /// points are distributed like the pixels.
    pub fn leave_one_out(&self) -> Vec<f64> {
        self.averaged(Self::left_out)
    }

    /// Returns the leave-one-out errors of the usable observations in this fit alone; for dense observations, those of the map,
    /// which follows each of them.
    fn left_out(&self) -> Vec<f64> {
        self.left_out_of_every(1)
    }

    /// Like [`Self::left_out`], for every `step`th observation.
    fn left_out_of_every(&self, step: usize) -> Vec<f64> {
        let Inner {
            scene, fit, usable, ..
        } = &*self.0;
        let mut errors = fit.leave_one_out(self.leverages());
        if usable.smoothed.is_some() {
            let steps = usable.depths.iter().zip(usable.fitted());
            let pairs = errors.iter_mut().zip(steps);
            pairs.for_each(|(error, (given, fitted))| *error += f64::from(given - fitted));
        }
        let errors: Vec<f64> = errors.into_iter().step_by(step).collect();
        let (residuals, weights) = (&fit.residuals, &fit.point_weights);
        scene.completer().run(|| {
            let Some((pixel_residuals, upsampling)) = self.pixel_residuals() else {
                return errors;
            };
            let left_out = |(place, &error): (usize, &f64)| {
                let i = place * step;
                let own = [residuals[i], weights[i], error];
                pixel_residuals.left_out(upsampling, usable.places[i], own)
            };
            errors.par_iter().enumerate().map(left_out).collect()
        })
    }

    /// Returns the residuals of the observations in each pixel, if observations are dense.
    fn pixel_residuals(&self) -> Option<(&PixelResiduals, &Upsampling)> {
        let Inner { scene, detail, .. } = &*self.0;
        Some((detail.as_ref()?.pixel_residuals(), scene.upsampling()?))
    }

    /// Reduces standard deviations of the fit, a map of `size` (height, width), where the map follows dense
    /// observations.
    pub(crate) fn reduce_deviations(&self, size: (usize, usize), deviations: &mut [f32]) {
        /// Largest number of observations whose errors scale the deviations.
        const SAMPLE: usize = 20_000;
        if let Some((pixel_residuals, upsampling)) = self.pixel_residuals() {
            let places = &self.0.usable.places;
            let step = places.len().div_ceil(SAMPLE);
            let errors = self.left_out_of_every(step);
            let places: Vec<_> = places.iter().copied().step_by(step).collect();
            pixel_residuals.reduce(upsampling, (&places, &errors), size, deviations);
        }
    }

    /// Root mean square of the leave-one-out errors; `None` if no observation has one, because the fit interpolates all of them
    /// exactly for any depths.
    pub fn leave_one_out_error(&self) -> Option<f64> {
        let mut errors = self.averaged_usable(Self::left_out);
        errors.retain(|error| !error.is_nan());
        (!errors.is_empty()).then(|| root_mean_square(&errors))
    }

    /// The final weight of every given observation, which is 1 in a plain fit without standard deviations, and smaller for
    /// observations with larger standard deviations; NaN for unused observations.
    pub fn point_weights(&self) -> Vec<f64> {
        self.averaged(|own| own.0.fit.point_weights.clone())
    }

    /// The observations that are more likely outliers than inliers, worst first. Each is compared with its prediction from the
    /// others. The standard deviation of this prediction depends on their distances and on the edges of the image between them.
    /// At [`Quality::Best`](crate::Quality::Best), the probability is the mean of those in the image and in its mirror image.
    ///
    /// # Errors
    /// The equations cannot be solved, or the network is damaged.
    pub fn outliers(&self) -> Result<Vec<Outlier>> {
        let Inner { usable, mirror, .. } = &*self.0;
        let mut posteriors = self.scene().inlier_posteriors(usable)?;
        if let Some(mirror) = mirror {
            let others = mirror.scene().inlier_posteriors(mirror.usable())?;
            for (own, other) in posteriors.iter_mut().zip(others) {
                own.p_inlier = own.p_inlier.midpoint(other.p_inlier);
                own.error = own.error.midpoint(other.error);
                own.scale = own.scale.midpoint(other.scale);
            }
        }
        let weights = self.averaged_usable(|own| own.0.fit.point_weights.clone());
        let outlier = |(i, found): (usize, InlierPosterior)| Outlier {
            index: usable.indices[i],
            probability: 1.0 - found.p_inlier,
            score: found.error / found.scale,
            error: found.error,
            weight: weights[i],
        };
        let mut found: Vec<_> = posteriors
            .into_iter()
            .enumerate()
            .filter(|(_, found)| found.p_inlier < 0.5)
            .map(outlier)
            .collect();
        found.sort_by(|a, b| b.score.abs().total_cmp(&a.score.abs()));
        Ok(found)
    }

    /// The weights of the basis functions: first that of the constant (or of the map that replaces it), then those of the other
    /// functions and of the cosine basis, as taken by [`Scene::complete_near`]. At [`Quality::Best`](crate::Quality::Best), the
    /// weights of the fit to the mirror image follow.
    pub fn weights(&self) -> &[f64] {
        &self.0.weights
    }

    pub(crate) fn fit(&self) -> &Fit {
        &self.0.fit
    }

    pub(crate) fn usable(&self) -> &UsableObservations {
        &self.0.usable
    }

    /// The scene that was fitted.
    pub fn scene(&self) -> &Scene {
        &self.0.scene
    }

    pub(crate) fn leverages(&self) -> &[f64] {
        let Inner {
            scene,
            fit,
            usable,
            leverages,
            ..
        } = &*self.0;
        let bases = || scene.at(scene.size(), &usable.places);
        let compute = || scene.completer().run(|| fit.leverages_with(bases));
        get_or_compute(leverages, compute).as_slice()
    }
}
