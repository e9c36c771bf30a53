//! A fit, and what follows from it: depth anywhere, standard deviations, residuals, outliers.

use crate::error::{FitError, Result};
use crate::fit::{Fit, FitMethod, LocalNoise};
use crate::image::{check_rows, check_size};
use crate::map::DepthMap;
use crate::scene::Scene;
use crate::usable::Usable;
use rayon::prelude::*;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

/// Depths stay within the range of the observations widened by this factor both ways. Relative, so
/// that scaling the observations scales the result.
pub const RANGE: f32 = 10.0;

/// The score above which an observation is called an outlier (Iglewicz and Hoaglin 1993).
pub const OUTLYING: f64 = 3.5;

/// Pixels whose basis functions are held at once.
const STRIP: usize = 1 << 13;

/// A scene fitted to observations.
///
/// Nothing but the fit is computed until it is asked for. Depths are in the unit of the observations,
/// along the optical axis.
#[derive(Clone, Debug)]
pub struct Completion(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    scene: Scene,
    fit: Fit,
    usable: Usable,
    report: Report,
    leverages: OnceLock<Vec<f64>>,
}

/// How a fit went.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Report {
    /// Observations that were given: `used + invalid + outside`.
    pub given: usize,
    /// Those that were fitted.
    pub used: usize,
    /// Those whose depth or standard deviation is not from 1e-15 to 1e15, or whose place is not finite.
    pub invalid: usize,
    /// Those outside the image.
    pub outside: usize,
    /// Those of the used without a standard deviation of their own, where others had one: the median of
    /// these was taken.
    pub assumed_deviations: usize,
    /// What depth is made of.
    pub method: FitMethod,
    /// Root mean square of the residuals, in the unit of the observations.
    pub residual: f64,
    /// Directions that the observations determine, at most `functions`.
    pub rank: usize,
    /// Basis functions of the network, and the constant.
    pub functions: usize,
    /// How strongly the weights were drawn towards a prior, if there is one: the variance of the noise
    /// over that of the prior.
    pub lambda: Option<f64>,
    /// The time of the network.
    pub network: Duration,
    /// The time of the fit, with the basis functions at the observations.
    pub fit: Duration,
    /// The time of the solution alone.
    pub solve: Duration,
}

/// An observation that does not agree with the others.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Outlier {
    /// Which of the given observations.
    pub index: usize,
    /// How many robust standard deviations it lies off what the others say: positive where it is
    /// farther.
    pub score: f64,
    /// Its depth less what the others say.
    pub error: f64,
    /// How much a robust fit left of its weight.
    pub weight: f64,
}

impl Completion {
    pub(crate) fn new(
        scene: Scene,
        fit: Fit,
        usable: Usable,
        method: FitMethod,
        (network, fitting, solve): (Duration, Duration, Duration),
    ) -> Self {
        let report = Report {
            given: usable.given,
            used: usable.which.len(),
            invalid: usable.invalid,
            outside: usable.outside,
            assumed_deviations: usable.assumed,
            method,
            residual: fit.rms(),
            rank: fit.rank,
            functions: fit.functions(),
            lambda: fit.lambda,
            network,
            fit: fitting,
            solve,
        };
        Self(Arc::new(Inner {
            scene,
            fit,
            usable,
            report,
            leverages: OnceLock::new(),
        }))
    }

    /// How the fit went.
    pub fn report(&self) -> &Report {
        &self.0.report
    }

    /// The dense depth at the size of the image.
    ///
    /// # Errors
    /// None for images that a scene was made of.
    pub fn depth(&self) -> Result<DepthMap> {
        let (height, width) = self.0.scene.size();
        self.depth_at(width, height)
    }

    /// The dense depth at another size: basis functions and field are read between pixels, nothing is
    /// enlarged.
    ///
    /// # Errors
    /// An implausible size.
    pub fn depth_at(&self, width: usize, height: usize) -> Result<DepthMap> {
        check_size(width, height)?;
        DepthMap::new(width, height, self.dense((height, width)))
    }

    /// The dense depth into a buffer of the caller, rows `stride` values apart.
    ///
    /// # Errors
    /// An implausible size, rows that overlap, or a buffer that is too short; the buffer is then as it
    /// was.
    pub fn write_depth(
        &self,
        width: usize,
        height: usize,
        stride: usize,
        buffer: &mut [f32],
    ) -> Result<()> {
        check_size(width, height)?;
        check_rows(width, height, 1, stride, buffer.len())?;
        let values = self.dense((height, width));
        let rows = buffer.chunks_mut(stride).zip(values.chunks_exact(width));
        rows.for_each(|(row, values)| row[..width].copy_from_slice(values));
        Ok(())
    }

    /// The depth at places (u, v) of the image, in pixels from the centre of the first.
    ///
    /// # Errors
    /// A place that is not in the image.
    pub fn at(&self, places: &[[f64; 2]]) -> Result<Vec<f32>> {
        let Inner { scene, fit, .. } = &*self.0;
        let (height, width) = scene.size();
        let inside = |place: f64, length: usize| (-0.5..=length as f64 - 0.5).contains(&place);
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
        let rows = scene.completer().run(|| scene.at((height, width), places));
        let columns = rows.len() / places.len().max(1);
        let (low, high) = self.limits();
        let value = |(row, &place): (&[f32], &[f64; 2])| {
            let functions = row.iter().zip(&fit.weights).map(|(b, w)| f64::from(*b) * w);
            let smooth = fit
                .smooth()
                .map_or(0.0, |smooth| smooth.at(place, (height, width)));
            let value = functions.sum::<f64>() + smooth;
            (fit.space.depth(value) as f32).clamp(low, high)
        };
        Ok(rows
            .chunks_exact(columns.max(1))
            .zip(places)
            .map(value)
            .collect())
    }

    /// The range that depths are clamped to: that of the observations, widened by [`RANGE`] both ways.
    pub fn limits(&self) -> (f32, f32) {
        let (low, high) = self.0.usable.range();
        (low / RANGE, high * RANGE)
    }

    fn dense(&self, size: (usize, usize)) -> Vec<f32> {
        let Inner { scene, fit, .. } = &*self.0;
        scene.completer().run(|| {
            let mut values = scene.combine(size, &fit.weights);
            if let Some(smooth) = fit.smooth() {
                smooth.add_to(size, &mut values);
            }
            let (low, high) = self.limits();
            values.par_iter_mut().for_each(|value| {
                *value = (fit.space.depth(f64::from(*value)) as f32).clamp(low, high);
            });
            values
        })
    }

    /// The standard deviation of the error of every pixel of the image. The factor that makes it agree with
    /// errors was found in training with the fit that the weights record; with other settings it is an
    /// approximation.
    ///
    /// # Errors
    /// Too few observations to say.
    pub fn standard_deviation(&self) -> Result<DepthMap> {
        let (height, width) = self.0.scene.size();
        self.standard_deviation_at(width, height)
    }

    /// The standard deviation of the error of every pixel at another size: that of the noise around it
    /// and that of the weights, which grows away from what the observations determine.
    ///
    /// # Errors
    /// An implausible size, or too few observations to say.
    pub fn standard_deviation_at(&self, width: usize, height: usize) -> Result<DepthMap> {
        check_size(width, height)?;
        let values = self
            .0
            .scene
            .completer()
            .run(|| self.deviations((height, width)))?;
        DepthMap::new(width, height, values)
    }

    fn deviations(&self, (height, width): (usize, usize)) -> Result<Vec<f32>> {
        let Inner {
            scene, fit, usable, ..
        } = &*self.0;
        let from = scene.size();
        let factor = scene.completer().deviation();
        if fit.is_saturated() {
            let what = "as many observations as basis functions, or fewer, are met whatever they are, and \
                        say nothing of the errors between them";
            return Err(FitError::TooFewPoints(what).into());
        }
        let noise = LocalNoise::new(fit, self.leverages(), &usable.places, from);
        let (right, down) = (from.1 as f64 / width as f64, from.0 as f64 / height as f64);
        let noise_at = |pixel: usize| {
            let (x, y) = ((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5);
            noise.at(x * right, y * down)
        };
        let mut values = vec![0.0; height * width];
        if noise.is_silent() {
            let what = "the points say nothing of how far the depth is off between them";
            return Err(FitError::TooFewPoints(what).into());
        }
        if let Some(deviations) = fit.field_deviations(|size, places| scene.at(size, places)) {
            deviations.add_to((height, width), &mut values);
            values
                .par_iter_mut()
                .enumerate()
                .for_each(|(pixel, value)| {
                    *value = (factor * noise_at(pixel).sqrt() * f64::from(*value)) as f32;
                });
            return Ok(values);
        }
        let depth = self.dense((height, width));
        let strips = values.par_chunks_mut(STRIP).enumerate();
        strips.for_each(|(strip, values)| {
            let pixels = strip * STRIP..strip * STRIP + values.len();
            let place = |pixel: usize| [(pixel % width) as f64, (pixel / width) as f64];
            let places: Vec<_> = pixels.clone().map(place).collect();
            let spreads = fit.spreads(&scene.at((height, width), &places));
            for ((value, spread), pixel) in values.iter_mut().zip(spreads).zip(pixels) {
                let variance = noise_at(pixel) * (1.0 + f64::from(spread));
                let slope = fit.space.slope(f64::from(depth[pixel]));
                *value = (factor * variance.sqrt() * slope) as f32;
            }
        });
        Ok(values)
    }

    /// For every given observation its depth less the fitted one, before the latter is clamped; NaN for
    /// those that were not used.
    pub fn residuals(&self) -> Vec<f64> {
        self.0.usable.spread(&self.0.fit.residuals)
    }

    /// For every given observation its depth less what a fit to all others would say there (leave-one-
    /// out, in closed form: Allen 1974); NaN for those that were not used, and for those that the fit meets
    /// whatever their depths are. The root mean square, the
    /// PRESS error, says without a true depth map how far the depth is off between the points, where
    /// these are spread as the pixels are.
    pub fn leave_one_out(&self) -> Vec<f64> {
        self.0
            .usable
            .spread(&self.0.fit.leave_one_out(self.leverages()))
    }

    /// Root mean square of the leave-one-out errors; `None` if no observation has one, because the fit
    /// meets all of them whatever their depths are.
    pub fn leave_one_out_error(&self) -> Option<f64> {
        self.0.fit.leave_one_out_error(self.leverages())
    }

    /// For every given observation how much it counted in the end, 1 for a plain fit without standard
    /// deviations; NaN for those that were not used.
    pub fn point_weights(&self) -> Vec<f64> {
        self.0.usable.spread(&self.0.fit.point_weights)
    }

    /// The observations that do not agree with the others, the worst first: those more than
    /// [`OUTLYING`] robust standard deviations off.
    pub fn outliers(&self) -> Vec<Outlier> {
        let Inner { fit, usable, .. } = &*self.0;
        let scores = fit.scores(self.leverages());
        let errors = fit.leave_one_out(self.leverages());
        let outlier = |(i, score): (usize, f64)| Outlier {
            index: usable.which[i],
            score,
            error: errors[i],
            weight: fit.point_weights[i],
        };
        let scores = scores.into_iter().enumerate();
        let mut found: Vec<_> = scores
            .filter(|(_, score)| score.abs() > OUTLYING)
            .map(outlier)
            .collect();
        found.sort_by(|a, b| b.score.abs().total_cmp(&a.score.abs()));
        found
    }

    /// The weights of the basis functions, the constant first, then of cosines: what
    /// [`Scene::complete_near`] takes.
    pub fn weights(&self) -> &[f64] {
        &self.0.fit.weights
    }

    /// The scene that was fitted.
    pub fn scene(&self) -> &Scene {
        &self.0.scene
    }

    fn leverages(&self) -> &[f64] {
        let Inner {
            scene,
            fit,
            usable,
            leverages,
            ..
        } = &*self.0;
        if let Some(leverages) = leverages.get() {
            return leverages;
        }
        // Not within the initialiser: a thread that waits for others there may take up work that asks
        // for the same.
        let bases = || scene.at(scene.size(), &usable.places);
        let found = scene.completer().run(|| fit.leverages_with(bases));
        leverages.get_or_init(|| found)
    }
}
