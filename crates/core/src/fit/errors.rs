//! The distribution of the errors of completed depth, given features of each pixel.
//!
//! The error of a pixel divided by its scale follows Student's t distribution: errors are small at most pixels and large at a
//! few, at missed edges. The logarithm of the scale is a sum of [features](PixelFeatures) of the pixel, each multiplied by an
//! exponent. The posterior variance of the fit, which assumes normal depth steps and correct affinities, is only one of the
//! features.

use super::student_t;
use crate::error::WeightsError;
use faer::linalg::solvers::Solve as _;
use faer::{Mat, Side};
use serde::{Deserialize, Serialize};

/// Number of features of a pixel.
pub const PIXEL_FEATURES: usize = 9;

/// Features of a pixel, all logarithms of ratios, so that scaling all depths does not change them:
///
/// - the constant 1;
/// - the deviation of the field's steps, over the mean depth of the points;
/// - the posterior deviation of the field alone, in units of the deviation of these steps;
/// - the posterior deviation of the basis functions;
/// - the noise around the block, over that of the image, by leave-one-out errors;
/// - the range of the completed depth in the block and those around it, over the mean depth;
/// - the completed depth, over the mean depth;
/// - the affinities around the block;
/// - the distance to the nearest point, over the mean distance between points.
pub type PixelFeatures = [f32; PIXEL_FEATURES];

/// Number of point counts for which the distribution is calibrated.
pub const CALIBRATION_NODES: usize = 4;

/// The distribution of errors for several numbers of points, in ascending order. In between, exponents and the logarithm of the
/// degrees of freedom are interpolated in the logarithm of the number.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ErrorModel(pub [CalibrationNode; CALIBRATION_NODES]);

/// The distribution of errors for one number of points.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CalibrationNode {
    /// The number of points.
    pub points: f64,
    /// The degrees of freedom of Student's t: the fewer, the heavier the tails.
    pub freedom: f64,
    /// The exponent of each feature.
    pub exponents: [f64; PIXEL_FEATURES],
}

/// An error, in units of the mean depth, and the features of its pixel.
pub type ErrorSample = (PixelFeatures, f32);

impl ErrorModel {
    /// Checks every number.
    ///
    /// # Errors
    /// Numbers that are not finite, degrees of freedom that are not positive, or numbers of points that do not increase.
    pub fn check(&self) -> Result<(), WeightsError> {
        let sound = |node: &CalibrationNode| {
            (CalibrationNode::LEAST..=CalibrationNode::MOST).contains(&node.freedom)
                && node.points > 0.0
                && node.points.is_finite()
                && node.exponents.iter().all(|e| e.is_finite())
        };
        if self.0.iter().all(sound) && self.0.is_sorted_by(|a, b| a.points < b.points) {
            Ok(())
        } else {
            let what = "the distribution of errors is out of range";
            Err(WeightsError::record("calibration", what))
        }
    }

    /// The distribution for a number of points.
    pub fn at(&self, points: usize) -> CalibrationNode {
        let place = (points.max(1) as f64).ln();
        let between = |[from, to]: &[CalibrationNode; 2]| {
            let (start, end) = (from.points.ln(), to.points.ln());
            (start..end).contains(&place).then(|| {
                let share = (place - start) / (end - start);
                let mix = |a: f64, b: f64| a + share * (b - a);
                CalibrationNode {
                    points: points as f64,
                    freedom: mix(from.freedom.ln(), to.freedom.ln()).exp(),
                    exponents: std::array::from_fn(|i| mix(from.exponents[i], to.exponents[i])),
                }
            })
        };
        let end = if place < self.0[0].points.ln() {
            0
        } else {
            CALIBRATION_NODES - 1
        };
        self.0
            .array_windows()
            .find_map(between)
            .unwrap_or(self.0[end])
    }
}

impl CalibrationNode {
    /// The range of the degrees of freedom: below it, the distribution has no mean; above it, errors are nearly normal.
    const LEAST: f64 = 1.0;
    const MOST: f64 = 200.0;

    /// The scale of the error of a pixel, in units of the mean depth.
    pub fn scale(&self, features: &PixelFeatures) -> f64 {
        self.log_scale(features).exp()
    }

    fn log_scale(&self, features: &PixelFeatures) -> f64 {
        let pairs = features.iter().zip(&self.exponents);
        pairs
            .map(|(feature, exponent)| f64::from(*feature) * exponent)
            .sum()
    }

    /// Learns the maximum-likelihood distribution of `samples`: exponents by Fisher scoring, with the information 2 freedom /
    /// (freedom + 3) on the logarithm of a scale, and the degrees of freedom by golden section. `None` if there are too few
    /// samples.
    pub fn learn(points: f64, samples: &[ErrorSample]) -> Option<Self> {
        const ROUNDS: usize = 40;
        /// Ridge relative to the number of samples, which draws the exponents of features that never vary to 0. The constant 1
        /// is not shrunk.
        const RIDGE: f64 = 1e-4;
        let mut normal = Mat::<f64>::zeros(PIXEL_FEATURES, PIXEL_FEATURES);
        for (features, _) in samples {
            for i in 0..PIXEL_FEATURES {
                for j in 0..PIXEL_FEATURES {
                    normal[(i, j)] += f64::from(features[i]) * f64::from(features[j]);
                }
            }
        }
        for i in 0..PIXEL_FEATURES {
            normal[(i, i)] += RIDGE * samples.len() as f64;
        }
        let normal = normal.llt(Side::Lower).ok()?;
        let typical = samples
            .iter()
            .map(|(_, e)| f64::from(e.abs()).max(1e-9).ln());
        let mut found = Self {
            points,
            freedom: 4.0,
            exponents: [0.0; PIXEL_FEATURES],
        };
        found.exponents[0] = typical.sum::<f64>() / samples.len() as f64;
        for _ in 0..ROUNDS {
            let freedom = found.freedom;
            let step = (freedom + 3.0) / (2.0 * freedom);
            let mut right = Mat::<f64>::zeros(PIXEL_FEATURES, 1);
            for (features, error) in samples {
                let square = found.square(features, *error);
                let slope = (freedom + 1.0) * square / (freedom + square) - 1.0;
                for i in 0..PIXEL_FEATURES {
                    right[(i, 0)] += step * slope * f64::from(features[i]);
                }
            }
            for i in 0..PIXEL_FEATURES {
                let shrink = RIDGE * samples.len() as f64 * found.exponents[i];
                right[(i, 0)] -= if i == 0 { 0.0 } else { shrink };
            }
            let change = normal.solve(&right);
            for (i, exponent) in found.exponents.iter_mut().enumerate() {
                *exponent += change[(i, 0)];
            }
            found.freedom = found.likeliest_freedom(samples);
        }
        found
            .exponents
            .iter()
            .all(|e| e.is_finite())
            .then_some(found)
    }

    /// The squared error in units of the squared scale.
    fn square(&self, features: &PixelFeatures, error: f32) -> f64 {
        (f64::from(error) * (-self.log_scale(features)).exp()).powi(2)
    }

    fn likeliest_freedom(&self, samples: &[ErrorSample]) -> f64 {
        const GOLDEN: f64 = 0.618_033_988_749_894_9;
        let squares: Vec<f64> = samples.iter().map(|(c, e)| self.square(c, *e)).collect();
        let cost = |x: f64| {
            let freedom = x.exp();
            let rest = student_t::neg_log_likelihood(0.0, freedom) * squares.len() as f64;
            let tails: f64 = squares.iter().map(|s| (s / freedom).ln_1p()).sum();
            rest + 0.5 * (freedom + 1.0) * tails
        };
        let (mut low, mut high) = (Self::LEAST.ln(), Self::MOST.ln());
        let (mut a, mut b) = (high - GOLDEN * (high - low), low + GOLDEN * (high - low));
        let (mut cost_a, mut cost_b) = (cost(a), cost(b));
        while high - low > 1e-3 {
            if cost_a < cost_b {
                (high, b, cost_b) = (b, a, cost_a);
                a = high - GOLDEN * (high - low);
                cost_a = cost(a);
            } else {
                (low, a, cost_a) = (a, b, cost_b);
                b = low + GOLDEN * (high - low);
                cost_b = cost(b);
            }
        }
        f64::midpoint(low, high).exp()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsdc_rng::Rng;

    fn node(points: f64, freedom: f64, shift: f64) -> CalibrationNode {
        let mut exponents = [0.0; PIXEL_FEATURES];
        (exponents[0], exponents[2], exponents[5]) = (shift, 0.8, -0.3);
        CalibrationNode {
            points,
            freedom,
            exponents,
        }
    }

    /// t = z sqrt(freedom / chi^2), with chi^2 the sum of squares of as many normal numbers.
    #[test]
    fn a_distribution_is_learned_from_its_own_errors() {
        let mut rng = Rng::stream(5, &["errors"]);
        let truth = node(50.0, 4.0, -2.0);
        let samples: Vec<ErrorSample> = (0..40_000)
            .map(|_| {
                let mut features = [0.0_f32; PIXEL_FEATURES];
                for feature in &mut features {
                    *feature = rng.normal();
                }
                features[0] = 1.0;
                let chi: f64 = (0..4).map(|_| f64::from(rng.normal()).powi(2)).sum();
                let t = f64::from(rng.normal()) * (4.0 / chi).sqrt();
                (features, (t * truth.scale(&features)) as f32)
            })
            .collect();
        let found = CalibrationNode::learn(50.0, &samples).unwrap();
        // Three standard errors: sqrt((freedom + 3) / (2 freedom n)) = 0.0047.
        for (found, truth) in found.exponents.iter().zip(truth.exponents) {
            assert!((found - truth).abs() < 0.015, "{found} {truth}");
        }
        assert!((found.freedom - 4.0).abs() < 0.3, "{}", found.freedom);
        assert!(CalibrationNode::learn(50.0, &[]).is_none());
    }

    #[test]
    fn between_two_numbers_of_points_logarithms_are_interpolated() {
        let model = ErrorModel([
            node(5.0, 2.0, 0.0),
            node(50.0, 8.0, 1.0),
            node(500.0, 3.0, 2.0),
            node(5000.0, 3.0, 4.0),
        ]);
        model.check().unwrap();
        assert_eq!(model.at(1), model.0[0]);
        let found = model.at(50);
        assert!((found.freedom - 8.0).abs() < 1e-12 && (found.exponents[0] - 1.0).abs() < 1e-12);
        assert_eq!(model.at(90_000), model.0[3]);
        let found = model.at(1581);
        assert!((found.exponents[0] - 3.0).abs() < 1e-4 && (found.freedom - 3.0).abs() < 1e-12);
        let found = model.at(16);
        let share = (16.0_f64 / 5.0).ln() / 10.0_f64.ln();
        assert!((found.freedom - 2.0 * 4.0_f64.powf(share)).abs() < 1e-12);
        let mut wrong = model;
        wrong.0.swap(0, 1);
        assert!(wrong.check().is_err());
    }
}
