//! Errors of a dense depth map against the truth, and their averages over frames.

use crate::data::DepthMap;
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// The errors of one frame, over the pixels with a true depth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Scores {
    /// Root mean square error in metres.
    pub rmse: f64,
    /// Mean absolute error in metres.
    pub mae: f64,
    /// Mean of |error| / true depth.
    pub rel: f64,
    /// Share of pixels with max(p/d, d/p) below 1.25.
    pub delta1: f64,
    /// The same below 1.25 squared.
    pub delta2: f64,
    /// The same below 1.25 cubed.
    pub delta3: f64,
}

/// Predictions below this many metres count as this in ratios.
pub const SMALLEST: f64 = 1e-3;

impl Scores {
    /// Compares a prediction with the truth.
    ///
    /// # Errors
    /// Maps of different sizes, or a truth without any depth.
    pub fn of(prediction: &DepthMap, truth: &DepthMap) -> Result<Self> {
        let size = |map: &DepthMap| (map.width(), map.height());
        if size(prediction) != size(truth) {
            return Err(Error::shape(format!(
                "prediction {:?} and truth {:?} (width, height) differ in size",
                size(prediction),
                size(truth)
            )));
        }
        let mut sums = Self::default();
        let mut count = 0.0;
        for (&p, &d) in prediction.values().iter().zip(truth.values()) {
            if d == 0.0 {
                continue;
            }
            let (p, d) = (f64::from(p), f64::from(d));
            let ratio = (p.max(SMALLEST) / d).max(d / p.max(SMALLEST));
            count += 1.0;
            sums.rmse += (p - d).powi(2);
            sums.mae += (p - d).abs();
            sums.rel += (p - d).abs() / d;
            sums.delta1 += f64::from(ratio < 1.25);
            sums.delta2 += f64::from(ratio < 1.25_f64.powi(2));
            sums.delta3 += f64::from(ratio < 1.25_f64.powi(3));
        }
        if count == 0.0 {
            return Err(Error::shape("the true depth map has no measurement"));
        }
        let mut means = sums.map(|sum| sum / count);
        means.rmse = means.rmse.sqrt();
        Ok(means)
    }

    fn map(self, f: impl Fn(f64) -> f64) -> Self {
        Self {
            rmse: f(self.rmse),
            mae: f(self.mae),
            rel: f(self.rel),
            delta1: f(self.delta1),
            delta2: f(self.delta2),
            delta3: f(self.delta3),
        }
    }
}

/// The sum of the scores of several frames; averages per frame, as the field does.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tally {
    frames: usize,
    sum: Scores,
}

impl Tally {
    /// Adds a frame.
    pub fn add(&mut self, scores: &Scores) {
        self.frames += 1;
        self.sum.rmse += scores.rmse;
        self.sum.mae += scores.mae;
        self.sum.rel += scores.rel;
        self.sum.delta1 += scores.delta1;
        self.sum.delta2 += scores.delta2;
        self.sum.delta3 += scores.delta3;
    }

    /// The number of frames.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// The mean over frames, or `None` without any.
    pub fn mean(&self) -> Option<Scores> {
        (self.frames > 0).then(|| self.sum.map(|sum| sum / self.frames as f64))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(values: &[f32]) -> DepthMap {
        DepthMap::new(values.len(), 1, values.to_vec()).unwrap()
    }

    #[test]
    fn scores_match_a_hand_calculation() {
        // Errors 0.5, 0, -2 at depths 1, 2, 4; the last pixel has no truth.
        let scores = Scores::of(&map(&[1.5, 2.0, 2.0, 9.0]), &map(&[1.0, 2.0, 4.0, 0.0])).unwrap();
        assert!((scores.rmse - ((0.25_f64 + 4.0) / 3.0).sqrt()).abs() < 1e-9);
        assert!((scores.mae - 2.5 / 3.0).abs() < 1e-9);
        assert!((scores.rel - (0.5 + 0.5) / 3.0).abs() < 1e-9);
        // Ratios 1.5, 1, 2 against 1.25, 1.5625, 1.953125.
        assert!((scores.delta1 - 1.0 / 3.0).abs() < 1e-9);
        assert!((scores.delta2 - 2.0 / 3.0).abs() < 1e-9);
        assert!((scores.delta3 - 2.0 / 3.0).abs() < 1e-9);
    }

    #[test]
    fn the_mean_is_over_frames_not_pixels() {
        let mut tally = Tally::default();
        tally.add(&Scores::of(&map(&[2.0]), &map(&[1.0])).unwrap());
        tally.add(&Scores::of(&map(&[1.0, 1.0, 1.0]), &map(&[1.0, 1.0, 1.0])).unwrap());
        assert_eq!(tally.mean().unwrap().rmse, 0.5);
    }
}
