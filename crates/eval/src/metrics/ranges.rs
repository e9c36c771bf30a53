//! Errors by range of depth: their size, and the rates of missed and phantom obstacles. Counts are integers, so that sums of
//! shards are exact.

use crate::data::DepthMap;
use serde::{Deserialize, Serialize};

/// Lower limits of the ranges of true depth, in metres. Each range ends where the next one begins; the last one is unbounded.
pub const RANGE_STARTS: [f32; 5] = [0.0, 10.0, 20.0, 40.0, 80.0];

/// Ratio of prediction and truth beyond which an obstacle is missed or a phantom.
const FACTOR: f64 = 1.25;

/// Error sums of a set of pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "[u64; 6]", into = "[u64; 6]")]
pub struct ErrorCount {
    /// Number of pixels.
    pub pixels: u64,
    /// Sum of their squared errors, each rounded to square millimetres.
    pub squares: u64,
    /// Sum of their absolute errors, each rounded to micrometres.
    pub micrometres: u64,
    /// Sum of their absolute relative errors, each rounded to millionths.
    pub millionths: u64,
    /// Number of pixels with a prediction nearer than truth / 1.25: a phantom obstacle.
    pub phantom: u64,
    /// Number of pixels with a prediction farther than 1.25 x truth: a missed obstacle.
    pub missed: u64,
}

impl From<[u64; 6]> for ErrorCount {
    fn from([pixels, squares, micrometres, millionths, phantom, missed]: [u64; 6]) -> Self {
        Self {
            pixels,
            squares,
            micrometres,
            millionths,
            phantom,
            missed,
        }
    }
}

impl From<ErrorCount> for [u64; 6] {
    fn from(count: ErrorCount) -> Self {
        [
            count.pixels,
            count.squares,
            count.micrometres,
            count.millionths,
            count.phantom,
            count.missed,
        ]
    }
}

impl ErrorCount {
    fn count(&mut self, prediction: f64, truth: f64) {
        let error = (prediction - truth).abs();
        *self = self.plus(Self {
            pixels: 1,
            squares: (error * error * 1e6).round() as u64,
            micrometres: (error * 1e6).round() as u64,
            millionths: (error / truth * 1e6).round() as u64,
            phantom: u64::from(prediction < truth / FACTOR),
            missed: u64::from(prediction > truth * FACTOR),
        });
    }

    fn plus(self, other: Self) -> Self {
        let (own, other): ([u64; 6], [u64; 6]) = (self.into(), other.into());
        std::array::from_fn(|i| own[i].saturating_add(other[i])).into()
    }

    fn mean(self, sum: u64) -> f64 {
        sum as f64 / self.pixels as f64
    }

    /// Returns the root of the mean squared error in metres. This and the following are NaN without pixels.
    pub fn rmse(self) -> f64 {
        (self.mean(self.squares) * 1e-6).sqrt()
    }

    /// Returns the mean absolute error in metres.
    pub fn mae(self) -> f64 {
        self.mean(self.micrometres) * 1e-6
    }

    /// Returns the mean absolute relative error.
    pub fn rel(self) -> f64 {
        self.mean(self.millionths) * 1e-6
    }

    /// Returns the share of pixels whose prediction is nearer than truth / 1.25.
    pub fn phantom_rate(self) -> f64 {
        self.mean(self.phantom)
    }

    /// Returns the share of pixels whose prediction is farther than 1.25 x truth.
    pub fn missed_rate(self) -> f64 {
        self.mean(self.missed)
    }
}

/// Errors of a method by range of true depth.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DepthRangeErrors {
    /// Errors of all pixels.
    pub all: [ErrorCount; RANGE_STARTS.len()],
    /// Errors of pixels with a small standard deviation; `None` if no standard deviations were predicted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub certain: Option<[ErrorCount; RANGE_STARTS.len()]>,
}

impl DepthRangeErrors {
    /// Counts the pixels of a frame that have a true depth. `deviations` are the predicted standard deviations in metres, with
    /// the largest share of the predicted depth that counts as certain.
    pub fn of(
        prediction: &DepthMap,
        truth: &DepthMap,
        deviations: Option<(&DepthMap, f64)>,
    ) -> Self {
        let mut ranges = Self {
            certain: deviations.map(|_| Default::default()),
            ..Self::default()
        };
        let pixels = prediction.values().iter().zip(truth.values()).enumerate();
        for (i, (&p, &d)) in pixels.filter(|(_, (_, d))| **d > 0.0) {
            let range = RANGE_STARTS.partition_point(|start| *start <= d) - 1;
            let (p, d) = (f64::from(p), f64::from(d));
            ranges.all[range].count(p, d);
            if let (Some(certain), Some((deviations, cut))) = (&mut ranges.certain, deviations)
                && f64::from(deviations.values()[i]) <= cut * p
            {
                certain[range].count(p, d);
            }
        }
        ranges
    }

    /// Adds other frames.
    pub fn add(&mut self, other: &Self) {
        let add = |own: &mut [ErrorCount; RANGE_STARTS.len()],
                   other: &[ErrorCount; RANGE_STARTS.len()]| {
            for (own, other) in own.iter_mut().zip(other) {
                *own = own.plus(*other);
            }
        };
        add(&mut self.all, &other.all);
        if let Some(certain) = &other.certain {
            add(self.certain.get_or_insert_default(), certain);
        }
    }
}

/// Returns the sum over all ranges.
pub fn total(counts: &[ErrorCount]) -> ErrorCount {
    let counts = counts.iter().copied();
    counts.fold(ErrorCount::default(), ErrorCount::plus)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(values: &[f32]) -> DepthMap {
        DepthMap::new(values.len(), 1, values.to_vec()).unwrap()
    }

    #[test]
    fn pixels_are_counted_by_their_true_depth() {
        let truth = map(&[5.0, 10.0, 19.0, 0.0, 100.0, 40.0]);
        let prediction = map(&[6.5, 8.5, 15.0, 3.0, 90.0, 50.0]);
        // 1.5 / 6.5 is above a tenth; 0.8 / 8.5 and all others are not.
        let deviations = map(&[1.5, 0.8, 1.5, 0.1, 9.0, 5.0]);
        let ranges = DepthRangeErrors::of(&prediction, &truth, Some((&deviations, 0.1)));
        let pixels = ranges.all.map(|count| count.pixels);
        assert_eq!(pixels, [1, 2, 0, 1, 1]);
        let [near, next, empty, ..] = ranges.all;
        // 6.5 m instead of 5 m is 1.3 times as far.
        assert_eq!((near.missed, near.phantom), (1, 0));
        // 10 / 8.5 = 1.18, but 19 / 15 = 1.27; errors of 1.5 and 4 m.
        assert_eq!((next.missed, next.phantom), (0, 1));
        assert!((next.rmse() - (0.5_f64 * (2.25 + 16.0)).sqrt()).abs() < 1e-9);
        assert!((next.mae() - 2.75).abs() < 1e-9);
        assert!((next.rel() - 0.5 * (0.15 + 4.0 / 19.0)).abs() < 1e-6);
        assert!((next.phantom_rate(), next.missed_rate()) == (0.5, 0.0));
        assert!(empty.rmse().is_nan());
        // 50 / 40 is exactly the factor.
        assert_eq!((ranges.all[3].missed, ranges.all[3].phantom), (0, 0));
        let certain = ranges.certain.unwrap();
        assert_eq!(certain.map(|count| count.pixels), [0, 2, 0, 1, 1]);
        assert_eq!(total(&certain).missed, 0);
    }

    #[test]
    fn frames_add_and_survive_a_file() {
        let of = |prediction: f32| DepthRangeErrors::of(&map(&[prediction]), &map(&[12.0]), None);
        let mut sum = of(13.0);
        sum.add(&of(20.0));
        assert_eq!((sum.all[1].pixels, sum.all[1].missed), (2, 1));
        assert!((sum.all[1].mae() - 4.5).abs() < 1e-9);
        let text = serde_json::to_string(&sum).unwrap();
        assert_eq!(
            serde_json::from_str::<DepthRangeErrors>(&text).unwrap(),
            sum
        );
        let mut huge = sum.clone();
        huge.all[1].squares = u64::MAX - 1;
        huge.add(&sum);
        assert_eq!(huge.all[1].squares, u64::MAX);
    }
}
