//! The standard deviation of completed depths: the scale of the error at every pixel, and the intervals that contain a
//! given share of errors.

use crate::completion::Completion;
use crate::error::{FitError, Result, SettingsError};
use crate::fit::student_t::{self, ONE_DEVIATION};
use crate::fit::{
    Affinities, CalibrationNode, FitMethod, LocalNoise, PixelFeatures, SmoothField, Window,
};
use crate::image::check_size;
use crate::map::DepthMap;
use crate::nearest::NeighbourGrid;
use crate::sky::UnmeasuredSky;
use rayon::prelude::*;

/// Degrees of freedom at which Student's t distribution is practically normal.
pub(crate) const NORMAL: f64 = 1e6;

/// Number of pixels whose basis functions are in memory at once.
const STRIP: usize = 1 << 13;

impl Completion {
    /// The standard deviation of the depth error at every pixel of the image. It is calibrated for the fit settings recorded
    /// with the weights, and approximate for other settings. It is half the width of the interval around the depth that holds
    /// 68.27 % of errors, as one standard deviation does if errors are normal. Depth errors have heavier tails at missed edges;
    /// [`Self::interval`] returns the multiple of this map that holds another share. If observations are dense and the map
    /// follows each of them, it is scaled to their leave-one-out errors. Where a guide predicted by Depth Anything shows sky and
    /// no point is near, it is at least the depth, whose value means nothing there. Far nearer than all observations, it is at
    /// least the distance of the depth from the fitted one ([`Self::limits`]).
    ///
    /// At [`Quality::Best`](crate::Quality::Best) it is (a + b) / 2, where a and b are the standard deviations of both fits. It
    /// is not calibrated again: intervals hold at least their share of errors, and exactly that share only if the errors of
    /// both fits are the same. The squared scale of a mean of jointly normal or Student-t errors with correlation r,
    /// `(a^2 + b^2 + 2 r a b) / 4`, is at most the square of (a + b) / 2. Half the difference of both depths is not added: it
    /// is a part of a and b that their mean does not have.
    ///
    /// # Errors
    /// Too few observations for an estimate.
    pub fn standard_deviation(&self) -> Result<DepthMap> {
        let (height, width) = self.scene().size();
        self.standard_deviation_at(width, height)
    }

    /// The standard deviation of the depth error at every pixel of a map of another size.
    ///
    /// # Errors
    /// An implausible size, or too few observations for an estimate.
    pub fn standard_deviation_at(&self, width: usize, height: usize) -> Result<DepthMap> {
        check_size(width, height)?;
        let values = self.averaged_map(width, |own| own.own_deviations((height, width)))?;
        DepthMap::new(width, height, values)
    }

    /// Returns the standard deviations of this fit alone.
    fn own_deviations(&self, size: (usize, usize)) -> Result<Vec<f32>> {
        let completer = self.scene().completer();
        let mut values = completer.run(|| self.deviations(size))?;
        completer.run(|| {
            self.reduce_deviations(size, &mut values);
            let depth = self.dense(size);
            let limits = self.depth_limits();
            for (deviation, depth) in values.iter_mut().zip(&depth) {
                *deviation = deviation.max(limits.raised_by(*depth));
            }
            self.raise_in_sky(size, &depth, &mut values);
        });
        Ok(values)
    }

    /// Raises standard deviations to the depth where a predicted guide shows sky that no point measured.
    fn raise_in_sky(&self, size: (usize, usize), depth: &[f32], deviations: &mut [f32]) {
        let Some(sky) = UnmeasuredSky::of(self) else {
            return;
        };
        let pairs = deviations.iter_mut().zip(depth).zip(sky.mask(size));
        let in_sky = pairs.filter(|(_, is_sky)| *is_sky);
        in_sky.for_each(|((deviation, depth), _)| *deviation = deviation.max(*depth));
    }

    /// The number of pixels of the image that show sky that no point measured, by a guide that Depth Anything predicted. Their
    /// standard deviation is at least the depth, whose value means nothing there. 0 without such a guide.
    pub fn sky_pixels(&self) -> usize {
        let count = || {
            let mask = UnmeasuredSky::of(self)?.mask(self.scene().size());
            Some(mask.into_iter().filter(|is_sky| *is_sky).count())
        };
        self.scene().completer().run(|| count().unwrap_or(0))
    }

    /// The number of standard deviations around the depth that hold a share `level` of errors, from 0 to 1 (exclusive). Errors
    /// divided by their scale follow Student's t distribution with [`Self::freedom`] degrees of freedom, so that 95 % need more
    /// than 1.96 standard deviations.
    ///
    /// # Errors
    /// A level that is not between 0 and 1.
    pub fn interval(&self, level: f64) -> Result<f64> {
        if !(level > 0.0 && level < 1.0) {
            return Err(
                SettingsError::new("the level of an interval must be between 0 and 1").into(),
            );
        }
        let freedom = self.freedom().unwrap_or(NORMAL);
        Ok(student_t::bound(level, freedom) / student_t::bound(ONE_DEVIATION, freedom))
    }

    /// The degrees of freedom of the distribution of errors; `None` if it is assumed to be normal, because the weights or the
    /// settings of the fit have no other calibration.
    pub fn freedom(&self) -> Option<f64> {
        self.error_model().map(|node| node.freedom)
    }

    fn error_model(&self) -> Option<CalibrationNode> {
        let joint = self.report().method == FitMethod::Joint;
        let model = self.scene().completer().errors().filter(|_| joint)?;
        Some(model.at(self.report().used))
    }

    fn deviations(&self, size: (usize, usize)) -> Result<Vec<f32>> {
        let Some(node) = self.error_model() else {
            return self.normal_deviations(size);
        };
        let (features, from) = self.features()?;
        let unit = student_t::bound(ONE_DEVIATION, node.freedom) * self.mean_depth();
        let scales: Vec<f64> = features
            .par_iter()
            .map(|features| unit * node.scale(features))
            .collect();
        let mut values = vec![0.0; size.0 * size.1];
        SmoothField::new(from, &scales).add_to(size, &mut values);
        Ok(values)
    }

    /// The features of each block of pixels of the field of a joint fit, and the number of rows and columns of blocks.
    ///
    /// # Errors
    /// A fit without a field, or too few observations.
    #[doc(hidden)]
    pub fn features(&self) -> Result<(Vec<PixelFeatures>, (usize, usize))> {
        /// Standard deviation of the window of affinities, as a share of the root of the number of blocks.
        const WINDOW: f64 = 1.0 / 64.0;
        /// Lower bounds: relief and noise relative to the mean depth, and the variance due to the weights.
        const LEAST: f64 = 1e-3;
        const LEAST_NOISE: f64 = 1e-6;
        const LEAST_FIELD: f64 = 1e-30;
        /// In mean distances between points: other features predict errors better at shorter distances.
        const CLOSE: f64 = 0.1;
        let noise = self.local_noise()?;
        let (scene, fit) = (self.scene(), self.fit());
        let variances = fit.rough_variances(|size, places| scene.at(size, places))?;
        let (Some(variances), Some(affinities)) = (variances, scene.known_affinities()) else {
            return Err(FitError::NoAffinities("joint").into());
        };
        let size = variances.size;
        let (height, width) = size;
        let mean = self.mean_depth();
        let (depth, relief) = self.depth_and_relief(affinities);
        let window = Window::new(WINDOW * ((height * width) as f64).sqrt());
        let edges = window.means(&affinities.by_block().logarithms(), width);
        let whole = fit.noise().sqrt().max(LEAST_NOISE * mean);
        let (right, down) = (
            scene.width() as f64 / width as f64,
            scene.height() as f64 / height as f64,
        );
        let log = |value: f64| (value as f32).ln();
        let level = (whole / mean).ln() as f32;
        let neighbours = NeighbourGrid::new(&self.usable().places);
        let area = (scene.width() * scene.height()) as f64;
        let spacing = (area / self.usable().places.len() as f64).sqrt();
        let blocks = (0..height * width).into_par_iter();
        let features = blocks.map_init(Vec::new, |nearest, block| {
            let (x, y) = ((block % width) as f64 + 0.5, (block / width) as f64 + 0.5);
            let place = [x * right - 0.5, y * down - 0.5];
            let local = noise.at(x * right, y * down).sqrt() / whole;
            neighbours.find(place, 1, nearest);
            let away = nearest[0].0.sqrt() / spacing;
            let features: PixelFeatures = [
                1.0,
                level,
                0.5 * log(variances.field[block].max(LEAST_FIELD)),
                0.5 * log(variances.weights[block] + LEAST),
                log(local.max(LEAST)),
                log(relief[block] / mean + LEAST),
                log(depth[block] / mean),
                edges[block] as f32,
                log(away + CLOSE),
            ];
            features
        });
        Ok((features.collect(), size))
    }

    /// Returns the mean depth of each block, and the variation of depth in it and the eight blocks around it, in metres.
    fn depth_and_relief(&self, affinities: &Affinities) -> (Vec<f64>, Vec<f64>) {
        let (blocks, depth) = (affinities.blocks(), self.dense(affinities.size()));
        let start = (0.0, 0.0, f32::INFINITY, f32::NEG_INFINITY);
        let folded = blocks.fold(&depth, start, |(sum, count, low, high), depth| {
            (
                sum + f64::from(depth),
                count + 1.0,
                low.min(depth),
                high.max(depth),
            )
        });
        let (rows, columns) = blocks.counts();
        let around = |at: usize, length: usize| at.saturating_sub(1)..(at + 2).min(length);
        let relief = (0..rows * columns).into_par_iter().map(|block| {
            let (mut least, mut most) = (f32::INFINITY, f32::NEG_INFINITY);
            for row in around(block / columns, rows) {
                for column in around(block % columns, columns) {
                    let (_, _, low, high) = folded[row * columns + column];
                    (least, most) = (least.min(low), most.max(high));
                }
            }
            f64::from(most - least)
        });
        let means = folded.iter().map(|(sum, count, ..)| sum / count);
        (means.collect(), relief.collect())
    }

    /// The mean depth of the observations, the unit of the scale of errors.
    #[doc(hidden)]
    pub fn mean_depth(&self) -> f64 {
        let depths = &self.usable().depths;
        depths.iter().map(|d| f64::from(*d)).sum::<f64>() / depths.len().max(1) as f64
    }

    fn local_noise(&self) -> Result<LocalNoise> {
        let fit = self.fit();
        if fit.is_saturated() {
            let what = "as many observations as basis functions, or fewer, are met whatever they are, and \
                        say nothing of the errors between them";
            return Err(FitError::TooFewPoints(what).into());
        }
        let (places, size) = (&self.usable().places, self.scene().size());
        let noise = LocalNoise::new(fit, self.leverages(), places, size);
        if noise.is_unknown() {
            let what = "the points say nothing of how far the depth is off between them";
            return Err(FitError::TooFewPoints(what).into());
        }
        Ok(noise)
    }

    /// Returns standard deviations of a normal distribution: from local noise and the posterior variance, times a factor.
    fn normal_deviations(&self, (height, width): (usize, usize)) -> Result<Vec<f32>> {
        let (scene, fit) = (self.scene(), self.fit());
        let factor = scene.completer().deviation();
        let noise = self.local_noise()?;
        let from = scene.size();
        let (right, down) = (from.1 as f64 / width as f64, from.0 as f64 / height as f64);
        let noise_at = |pixel: usize| {
            let (x, y) = ((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5);
            noise.at(x * right, y * down)
        };
        let mut values = vec![0.0; height * width];
        if let Some(variances) = fit.variances(|size, places| scene.at(size, places))? {
            let pairs = variances.field.iter().zip(&variances.weights);
            let deviations: Vec<f64> = pairs.map(|(a, b)| (a + b).sqrt()).collect();
            SmoothField::new(variances.size, &deviations).add_to((height, width), &mut values);
            let pixels = values.par_iter_mut().enumerate();
            pixels.for_each(|(pixel, value)| {
                *value = (factor * noise_at(pixel).sqrt() * f64::from(*value)) as f32;
            });
            return Ok(values);
        }
        let strips = values.par_chunks_mut(STRIP).enumerate();
        strips.for_each(|(strip, values)| {
            let pixels = strip * STRIP..strip * STRIP + values.len();
            let place = |pixel: usize| [(pixel % width) as f64, (pixel / width) as f64];
            let places: Vec<_> = pixels.clone().map(place).collect();
            let spreads = fit.spreads(&scene.at((height, width), &places));
            for ((value, spread), pixel) in values.iter_mut().zip(spreads).zip(pixels) {
                let variance = noise_at(pixel) * (1.0 + f64::from(spread));
                *value = (factor * variance.sqrt()) as f32;
            }
        });
        Ok(values)
    }
}
