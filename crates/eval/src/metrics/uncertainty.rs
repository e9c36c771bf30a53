//! Evaluation of predicted standard deviations against the errors. Counts are integers, so that sums of shards are exact.

use crate::data::DepthMap;
use lsdc_core::fit::student_t;
use serde::{Deserialize, Serialize};

/// Number of slices of the pixels of a frame, sorted by certainty, and number of interval levels.
pub const SLICES: usize = 20;

/// Probabilities of normal errors within one and two standard deviations.
pub const LEVELS: [f64; 2] = [0.6827, 0.9545];

/// Degrees of freedom at which Student's t is close to normal.
const NORMAL_FREEDOM: f64 = 1e6;
/// Resolution of the negative log likelihood, in parts per unit.
const PER_UNIT: f64 = 1e6;
/// Lower bound of standard deviations in logarithms, in metres.
const MIN_SCALE: f64 = 1e-6;

/// A predicted distribution of errors: Student's t.
#[derive(Clone, Debug)]
pub struct PredictedErrors {
    /// Half the width of the intervals that contain 68.27 % of errors, at every pixel.
    pub deviations: DepthMap,
    /// Degrees of freedom; `None` if normal.
    pub freedom: Option<f64>,
}

/// Errors of a method compared with its predicted standard deviations.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct UncertaintyScores {
    /// Number of pixels whose error is within the interval of 68.27 %.
    pub within_one: u64,
    /// Number of pixels whose error is within the interval of 95.45 %.
    pub within_two: u64,
    /// Number of pixels by the smallest interval that contains their error: up to 5 %, up to 10 %, ...
    pub levels: [u64; SLICES],
    /// Negative log likelihood of the errors under the predicted density, per metre, summed, in millionths.
    #[serde(rename = "surprise")]
    pub neg_log_likelihood: i64,
    /// Pixels of each frame sorted by standard deviation, the most certain slice first.
    pub predicted: [Slice; SLICES],
    /// Pixels of each frame sorted by error, the ideal order.
    pub ideal: [Slice; SLICES],
}

/// Number of pixels, and the sum of their squared errors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "(u64, u64)", into = "(u64, u64)")]
pub struct Slice {
    /// Number of pixels.
    pub pixels: u64,
    /// Sum of their squared errors, each rounded to square millimetres.
    pub squares: u64,
}

impl From<(u64, u64)> for Slice {
    fn from((pixels, squares): (u64, u64)) -> Self {
        Self { pixels, squares }
    }
}

impl From<Slice> for (u64, u64) {
    fn from(slice: Slice) -> Self {
        (slice.pixels, slice.squares)
    }
}

impl UncertaintyScores {
    /// Measures the pixels of a frame with a true depth. The interval of a standard deviation of 0 contains no error.
    pub fn of(depth: &DepthMap, truth: &DepthMap, predicted_errors: &PredictedErrors) -> Self {
        let mut uncertainty = Self::default();
        let freedom = predicted_errors.freedom.unwrap_or(NORMAL_FREEDOM);
        let unit = student_t::bound(student_t::ONE_DEVIATION, freedom);
        let [one, two] = LEVELS.map(|level| student_t::bound(level, freedom));
        let bounds: Vec<f64> = (1..SLICES)
            .map(|i| student_t::bound(i as f64 / SLICES as f64, freedom))
            .collect();
        let pixels = depth
            .values()
            .iter()
            .zip(truth.values())
            .zip(predicted_errors.deviations.values());
        let mut pairs: Vec<(f64, f64)> = pixels
            .filter(|((_, truth), _)| **truth > 0.0)
            .map(|((depth, truth), deviation)| {
                (f64::from(*deviation), f64::from(depth - truth).abs())
            })
            .collect();
        for (deviation, error) in &pairs {
            let scale = deviation / unit;
            uncertainty.within_one += u64::from(*error < one * scale);
            uncertainty.within_two += u64::from(*error < two * scale);
            let level = bounds.partition_point(|bound| bound * scale <= *error);
            uncertainty.levels[level] += 1;
            let scale = scale.max(MIN_SCALE);
            let neg_log_likelihood =
                student_t::neg_log_likelihood((error / scale).powi(2), freedom) + scale.ln();
            uncertainty.neg_log_likelihood = uncertainty
                .neg_log_likelihood
                .saturating_add((PER_UNIT * neg_log_likelihood).round() as i64);
        }
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        fill_slices(&mut uncertainty.predicted, &pairs);
        pairs.sort_by(|a, b| a.1.total_cmp(&b.1));
        fill_slices(&mut uncertainty.ideal, &pairs);
        uncertainty
    }

    /// Adds other frames.
    pub fn add(&mut self, other: &Self) {
        self.within_one = self.within_one.saturating_add(other.within_one);
        self.within_two = self.within_two.saturating_add(other.within_two);
        for (own, other) in self.levels.iter_mut().zip(&other.levels) {
            *own = own.saturating_add(*other);
        }
        self.neg_log_likelihood = self
            .neg_log_likelihood
            .saturating_add(other.neg_log_likelihood);
        for (own, others) in [
            (&mut self.predicted, &other.predicted),
            (&mut self.ideal, &other.ideal),
        ] {
            for (slice, other) in own.iter_mut().zip(others) {
                slice.pixels = slice.pixels.saturating_add(other.pixels);
                slice.squares = slice.squares.saturating_add(other.squares);
            }
        }
    }

    fn pixels(&self) -> u64 {
        self.predicted.iter().map(|s| s.pixels).sum()
    }

    /// Returns the shares of errors within the intervals of 68.27 and 95.45 %.
    pub fn coverage(&self) -> (f64, f64) {
        let share = |count: u64| count as f64 / self.pixels().max(1) as f64;
        (share(self.within_one), share(self.within_two))
    }

    /// Returns pairs of a level and the share of errors within the intervals of that level, from 0 to 1.
    pub fn calibration(&self) -> Vec<(f64, f64)> {
        let all = self.levels.iter().sum::<u64>().max(1) as f64;
        let covered = self.levels.iter().scan(0, |sum, count| {
            *sum += count;
            Some(*sum as f64 / all)
        });
        let levels = (1..=SLICES).map(|i| i as f64 / SLICES as f64);
        std::iter::once((0.0, 0.0))
            .chain(levels.zip(covered))
            .collect()
    }

    /// Returns the mean negative log likelihood of the errors under the predicted density, per metre; lower is better.
    pub fn neg_log_likelihood(&self) -> f64 {
        self.neg_log_likelihood as f64 / PER_UNIT / self.pixels().max(1) as f64
    }

    /// Returns the sparsification curve, one entry per slice: the share of the most uncertain pixels removed from each frame,
    /// and the RMSE of the remaining pixels in metres, sorted by prediction and ideally.
    pub fn sparsification(&self) -> Vec<(f64, f64, f64)> {
        (0..SLICES)
            .map(|removed| {
                let share = removed as f64 / SLICES as f64;
                let remaining = SLICES - removed;
                (
                    share,
                    rmse(&self.predicted[..remaining]),
                    rmse(&self.ideal[..remaining]),
                )
            })
            .collect()
    }

    /// Returns the area between the two sparsification curves, divided by the RMSE of all pixels (AUSE, Ilg et al. 2018): 0 if
    /// the predicted order of errors is ideal.
    pub fn ause(&self) -> f64 {
        let curve = self.sparsification();
        let area: f64 = curve.iter().map(|(_, found, best)| found - best).sum();
        area / (SLICES as f64 * curve[0].1.max(f64::MIN_POSITIVE))
    }

    /// Returns the area divided by that of random removal: 1 if standard deviations are unrelated to errors.
    pub fn ause_of_random(&self) -> f64 {
        let curve = self.sparsification();
        let all = curve[0].1;
        let area: f64 = curve.iter().map(|(_, found, best)| found - best).sum();
        let random: f64 = curve.iter().map(|(_, _, best)| all - best).sum();
        area / random.max(f64::MIN_POSITIVE)
    }
}

fn fill_slices(slices: &mut [Slice; SLICES], pairs: &[(f64, f64)]) {
    let cut = |i: usize| i * pairs.len() / SLICES;
    for (i, slice) in slices.iter_mut().enumerate() {
        let part = &pairs[cut(i)..cut(i + 1)];
        slice.pixels = part.len() as u64;
        slice.squares = part
            .iter()
            .map(|(_, error)| (error * error * 1e6).round() as u64)
            .sum();
    }
}

fn rmse(slices: &[Slice]) -> f64 {
    let pixels: u64 = slices.iter().map(|s| s.pixels).sum();
    let squares: u64 = slices.iter().map(|s| s.squares).sum();
    (squares as f64 * 1e-6 / pixels.max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsdc_rng::Rng;

    fn normal(deviations: DepthMap) -> PredictedErrors {
        PredictedErrors {
            deviations,
            freedom: None,
        }
    }

    /// Draws errors from the predicted standard deviations, times `factor`.
    fn sampled(factor: f32, known: bool) -> UncertaintyScores {
        let mut rng = Rng::stream(2, &["certainty"]);
        let size = 200 * 200;
        let (mut depth, mut deviations) = (Vec::new(), Vec::new());
        for i in 0..size {
            let deviation = if i % 2 == 0 { 0.05 } else { 0.3 };
            depth.push(10.0 + factor * deviation * rng.normal());
            deviations.push(if known { deviation } else { 0.2 });
        }
        let map = |values: Vec<f32>| DepthMap::new(200, 200, values).unwrap();
        UncertaintyScores::of(
            &map(depth),
            &map(vec![10.0; size]),
            &normal(map(deviations)),
        )
    }

    #[test]
    fn normal_errors_are_covered_as_normal_errors_are() {
        let (one, two) = sampled(1.0, true).coverage();
        assert!(
            (one - 0.6827).abs() < 0.007 && (two - 0.9545).abs() < 0.004,
            "{one} {two}"
        );
        // Errors half as large: P(|z| < 2) and P(|z| < 4).
        let (one, two) = sampled(0.5, true).coverage();
        assert!((one - 0.9545).abs() < 0.004 && two > 0.9998, "{one} {two}");
        for (level, covered) in sampled(1.0, true).calibration() {
            assert!((level - covered).abs() < 0.01, "{level} {covered}");
        }
        // The entropy of a normal distribution, ln(sd) + ln(2 pi e) / 2, averaged over both halves.
        let entropy = 0.5 * (0.05_f64.ln() + 0.3_f64.ln()) + 1.418_938_5;
        let found = sampled(1.0, true).neg_log_likelihood();
        assert!((found - entropy).abs() < 0.015, "{found} {entropy}");
    }

    /// With one degree of freedom, Student's t is the Cauchy distribution, sampled as tan(pi (u - 1/2)): half of all absolute
    /// values are below 1, and 68.27 % below tan(0.34135 pi).
    #[test]
    fn intervals_of_heavy_tails_are_wider() {
        let size = 100 * 100;
        let unit = (0.341_345 * std::f64::consts::PI).tan() as f32;
        let sampled = (0..size).map(|i| {
            let u = (i as f32 + 0.5) / size as f32;
            1000.0 + (std::f32::consts::PI * (u - 0.5)).tan()
        });
        let map = |values: Vec<f32>| DepthMap::new(100, 100, values).unwrap();
        let predicted_errors = PredictedErrors {
            deviations: map(vec![unit; size]),
            freedom: Some(1.0),
        };
        let found = UncertaintyScores::of(
            &map(sampled.collect()),
            &map(vec![1000.0; size]),
            &predicted_errors,
        );
        let (one, two) = found.coverage();
        assert!(
            (one - 0.6827).abs() < 1e-3 && (two - 0.9545).abs() < 1e-3,
            "{one} {two}"
        );
        assert!(
            found
                .calibration()
                .iter()
                .all(|(level, covered)| (level - covered).abs() < 1e-3)
        );
    }

    #[test]
    fn removing_the_uncertain_half_leaves_the_errors_of_the_other() {
        let uncertainty = sampled(1.0, true);
        let curve = uncertainty.sparsification();
        let all = (f64::midpoint(0.05 * 0.05, 0.3 * 0.3)).sqrt();
        assert!((curve[0].1 - all).abs() < 3e-3, "{curve:?}");
        assert_eq!(curve[0].1, curve[0].2);
        assert!((curve[SLICES / 2].1 - 0.05).abs() < 1e-3);
        assert!(curve.iter().all(|(_, found, best)| best <= found));
        // A constant does not rank pixels: the curve is flat, and the area is larger.
        let blind = sampled(1.0, false);
        assert!((blind.sparsification()[SLICES / 2].1 - all).abs() < 0.01);
        assert!(blind.ause() > 2.0 * uncertainty.ause());
    }

    #[test]
    fn a_standard_deviation_of_0_holds_no_error() {
        let map = |values: [f32; 3]| DepthMap::new(3, 1, values.to_vec()).unwrap();
        let uncertainty = UncertaintyScores::of(
            &map([1.1, 2.0, 3.0]),
            &map([1.0, 2.5, 0.0]),
            &normal(map([0.0, 1.0, 1.0])),
        );
        assert_eq!(uncertainty.coverage(), (0.5, 0.5));
    }

    #[test]
    fn frames_add() {
        let (a, b) = (sampled(1.0, true), sampled(0.5, true));
        let mut sum = a.clone();
        sum.add(&b);
        assert_eq!(sum.within_one, a.within_one + b.within_one);
        assert_eq!(
            sum.ideal[3].squares,
            a.ideal[3].squares + b.ideal[3].squares
        );
    }

    #[test]
    fn sums_beyond_all_numbers_stay_at_the_largest() {
        let mut huge = UncertaintyScores {
            within_one: u64::MAX - 1,
            ..UncertaintyScores::default()
        };
        huge.predicted[0].squares = u64::MAX - 1;
        let other = huge.clone();
        huge.add(&other);
        assert_eq!(
            (huge.within_one, huge.predicted[0].squares),
            (u64::MAX, u64::MAX)
        );
    }
}
