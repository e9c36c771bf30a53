//! Error profiles: errors by depth, by distance to the nearest sparse point, and by size. Counts are integers, so that sums of
//! shards are exact.

use crate::data::DepthMap;
use serde::{Deserialize, Serialize};

/// Horizontal axis of an error profile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// True depth in metres: bins of a quarter octave, starting at 1/4 m.
    Depth,
    /// Distance to the nearest sparse point in pixels: bins of half an octave, starting at 1; the first bin contains the points
    /// themselves.
    Distance,
    /// The error itself in metres: bins of half an octave, starting at 1 mm; the first bin contains all smaller errors.
    Error,
}

impl Axis {
    /// Returns the smallest value, the bins per octave, and the number of bins.
    fn scale(self) -> (f64, f64, usize) {
        match self {
            Self::Depth => (0.25, 4.0, 44),
            Self::Distance => (1.0, 2.0, 20),
            Self::Error => (1e-3, 2.0, 32),
        }
    }

    fn bin(self, value: f64) -> usize {
        let (least, per_octave, bins) = self.scale();
        if value < least {
            return 0;
        }
        let bin = (value / least).log2() * per_octave;
        (bin as usize + 1).min(bins - 1)
    }

    /// Returns the middle of a bin, for drawing.
    pub fn middle(self, bin: usize) -> f64 {
        let (least, per_octave, _) = self.scale();
        least * ((bin as f64 - 0.5) / per_octave).exp2()
    }
}

/// Number of pixels of a bin, and the sum of their absolute errors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "(u64, u64)", into = "(u64, u64)")]
pub struct Bin {
    /// Number of pixels.
    pub pixels: u64,
    /// Sum of their absolute errors, each rounded to micrometres.
    pub micrometres: u64,
}

impl Bin {
    /// Returns the mean absolute error in metres; `None` without pixels.
    pub fn mean(self) -> Option<f64> {
        (self.pixels > 0).then(|| self.micrometres as f64 * 1e-6 / self.pixels as f64)
    }
}

impl From<(u64, u64)> for Bin {
    fn from((pixels, micrometres): (u64, u64)) -> Self {
        Self {
            pixels,
            micrometres,
        }
    }
}

impl From<Bin> for (u64, u64) {
    fn from(bin: Bin) -> Self {
        (bin.pixels, bin.micrometres)
    }
}

/// The absolute errors of a method along each axis.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct ErrorProfile {
    /// Errors by true depth.
    pub depth: Vec<Bin>,
    /// Errors by distance to the nearest sparse point.
    pub distance: Vec<Bin>,
    /// Errors by their size.
    pub error: Vec<Bin>,
}

impl ErrorProfile {
    /// Counts the pixels of a frame; `distances` are the distances to the nearest point, in pixels.
    pub fn of(prediction: &DepthMap, truth: &DepthMap, distances: &[f32]) -> Self {
        let mut profile = Self::default();
        let pixels = prediction
            .values()
            .iter()
            .zip(truth.values())
            .zip(distances);
        for ((&p, &d), &distance) in pixels {
            if d > 0.0 {
                let error = f64::from((p - d).abs());
                profile.count(Axis::Depth, f64::from(d), error);
                profile.count(Axis::Distance, f64::from(distance), error);
                profile.count(Axis::Error, error, error);
            }
        }
        profile
    }

    /// Returns the bins along an axis, up to the last bin with pixels.
    pub fn along(&self, axis: Axis) -> &[Bin] {
        match axis {
            Axis::Depth => &self.depth,
            Axis::Distance => &self.distance,
            Axis::Error => &self.error,
        }
    }

    /// Adds the pixels of another frame.
    pub fn add(&mut self, other: &Self) {
        for axis in [Axis::Depth, Axis::Distance, Axis::Error] {
            for (i, bin) in other.along(axis).iter().enumerate() {
                let sum = self.bin(axis, i);
                sum.pixels = sum.pixels.saturating_add(bin.pixels);
                sum.micrometres = sum.micrometres.saturating_add(bin.micrometres);
            }
        }
    }

    fn count(&mut self, axis: Axis, at: f64, error: f64) {
        let bin = self.bin(axis, axis.bin(at));
        bin.pixels += 1;
        bin.micrometres += (error * 1e6).round() as u64;
    }

    fn bin(&mut self, axis: Axis, i: usize) -> &mut Bin {
        let bins = match axis {
            Axis::Depth => &mut self.depth,
            Axis::Distance => &mut self.distance,
            Axis::Error => &mut self.error,
        };
        if bins.len() <= i {
            bins.resize(i + 1, Bin::default());
        }
        &mut bins[i]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_fall_into_their_bins() {
        let map = |values: [f32; 4]| DepthMap::new(4, 1, values.to_vec()).unwrap();
        let truth = map([1.0, 2.0, 0.0, 2.0]);
        let prediction = map([1.5, 2.0, 7.0, 2.25]);
        let profile = ErrorProfile::of(&prediction, &truth, &[0.0, 1.0, 2.0, 3.0]);
        // 1 m is two octaves above 1/4 m, 2 m is three.
        assert_eq!(profile.depth[9].mean(), Some(0.5));
        assert_eq!(profile.depth[13], Bin::from((2, 250_000)));
        assert_eq!(profile.distance[0].mean(), Some(0.5));
        assert_eq!(profile.distance[1].mean(), Some(0.0));
        assert_eq!(profile.distance[4].mean(), Some(0.25));
        assert_eq!(profile.error[0].pixels, 1);
        let mut sum = profile.clone();
        sum.add(&profile);
        assert_eq!(sum.depth[13], Bin::from((4, 500_000)));
        let (low, high) = (Axis::Depth.middle(9), Axis::Depth.middle(10));
        assert!(low > 1.0 && low < 1.1 && high > low);
    }
}
