//! Averages over frames.

use super::{Metric, Scores};

/// The sum of the scores of several frames, to average per frame, as is conventional. Frames without edges are excluded from
/// the mean of the soft edge error.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ScoreAccumulator {
    frames: usize,
    sum: Scores,
    count: Scores,
}

impl ScoreAccumulator {
    /// Adds a frame.
    pub fn add(&mut self, scores: &Scores) {
        self.frames += 1;
        for metric in Metric::ALL {
            if scores[metric].is_finite() {
                self.sum[metric] += scores[metric];
                self.count[metric] += 1.0;
            }
        }
    }

    /// Adds the frames of another accumulator.
    pub fn merge(&mut self, other: &Self) {
        self.frames += other.frames;
        for metric in Metric::ALL {
            self.sum[metric] += other.sum[metric];
            self.count[metric] += other.count[metric];
        }
    }

    /// Returns the mean over frames; `None` without frames.
    pub fn mean(&self) -> Option<Scores> {
        (self.frames > 0).then(|| self.sum.map(|metric, sum| sum / self.count[metric]))
    }
}

/// Returns the mean and standard deviation of each metric over repetitions. The deviation is that of a sample (n - 1), NaN for
/// a single repetition.
pub fn mean_and_deviation(repetitions: &[Scores]) -> (Scores, Scores) {
    let mut accumulator = ScoreAccumulator::default();
    for scores in repetitions {
        accumulator.add(scores);
    }
    let mean = accumulator.mean().unwrap_or_default();
    let spread = mean.map(|metric, mean| {
        let squares: f64 = repetitions.iter().map(|s| (s[metric] - mean).powi(2)).sum();
        (squares / (repetitions.len() as f64 - 1.0)).sqrt()
    });
    (
        mean,
        spread.map(|_, s| if repetitions.len() < 2 { f64::NAN } else { s }),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rmse(value: f64) -> Scores {
        Scores::default().map(|metric, _| match metric {
            Metric::Rmse => value,
            _ => f64::NAN,
        })
    }

    #[test]
    fn the_mean_is_over_the_frames_that_have_a_value() {
        let mut accumulator = ScoreAccumulator::default();
        accumulator.add(&rmse(1.0));
        accumulator.add(&rmse(2.0));
        accumulator.add(&rmse(f64::NAN));
        let mean = accumulator.mean().unwrap();
        assert_eq!(mean[Metric::Rmse], 1.5);
        assert!(mean[Metric::See].is_nan());
    }

    #[test]
    fn the_deviation_is_that_of_a_sample() {
        let (mean, spread) = mean_and_deviation(&[rmse(2.0), rmse(4.0), rmse(9.0)]);
        assert_eq!(mean[Metric::Rmse], 5.0);
        assert_eq!(spread[Metric::Rmse], 13.0_f64.sqrt());
        assert!(mean_and_deviation(&[rmse(2.0)]).1[Metric::Rmse].is_nan());
    }
}
