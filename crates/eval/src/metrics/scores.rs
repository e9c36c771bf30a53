//! Metrics of a frame.

use super::{Rules, edge};
use crate::data::DepthMap;
use lsdc_files::error::{Error, Result};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::collections::BTreeMap;
use std::ops::{Index, IndexMut};

/// A metric of a depth map, over the pixels with a true depth d and a prediction p.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Metric {
    /// Root of the mean of (p - d)^2, in metres.
    Rmse,
    /// Mean of |p - d|, in metres.
    Mae,
    /// Root of the mean of (1/p - 1/d)^2, in 1/km (Uhrig et al. 2017).
    Irmse,
    /// Mean of |1/p - 1/d|, in 1/km.
    Imae,
    /// Mean of |p - d| / d.
    Rel,
    /// Mean of |log10 p - log10 d| (Eigen et al. 2014).
    Log10,
    /// Root of the mean of (ln p - ln d)^2.
    RmseLog,
    /// Share with max(p/d, d/p) below 1.02.
    Delta102,
    /// Share with max(p/d, d/p) below 1.05.
    Delta105,
    /// Share with max(p/d, d/p) below 1.10.
    Delta110,
    /// Share with max(p/d, d/p) below 1.25 (Eigen et al. 2014).
    Delta1,
    /// Share with max(p/d, d/p) below 1.25 squared.
    Delta2,
    /// Share with max(p/d, d/p) below 1.25 cubed.
    Delta3,
    /// Soft edge error in metres (Chen et al. 2019): at edges of the truth, the smallest |p - d'| over the true depths d' of a
    /// window. NaN for a frame without edges.
    See,
}

impl Metric {
    /// All metrics, in the order of tables.
    pub const ALL: [Self; 14] = [
        Self::Rmse,
        Self::Mae,
        Self::Irmse,
        Self::Imae,
        Self::Rel,
        Self::Log10,
        Self::RmseLog,
        Self::Delta102,
        Self::Delta105,
        Self::Delta110,
        Self::Delta1,
        Self::Delta2,
        Self::Delta3,
        Self::See,
    ];

    /// Returns the name in files, the name in tables, and the unit in tables.
    fn names(self) -> [&'static str; 3] {
        match self {
            Self::Rmse => ["rmse", "RMSE", "m"],
            Self::Mae => ["mae", "MAE", "m"],
            Self::Irmse => ["irmse", "iRMSE", "1/km"],
            Self::Imae => ["imae", "iMAE", "1/km"],
            Self::Rel => ["rel", "REL", ""],
            Self::Log10 => ["log10", "log10", ""],
            Self::RmseLog => ["rmse_log", "RMSElog", ""],
            Self::Delta102 => ["delta_1.02", "d1.02", "%"],
            Self::Delta105 => ["delta_1.05", "d1.05", "%"],
            Self::Delta110 => ["delta_1.10", "d1.10", "%"],
            Self::Delta1 => ["delta1", "d1.25", "%"],
            Self::Delta2 => ["delta2", "d1.25^2", "%"],
            Self::Delta3 => ["delta3", "d1.25^3", "%"],
            Self::See => ["see", "SEE", "m"],
        }
    }

    /// Returns the name in files.
    pub fn key(self) -> &'static str {
        self.names()[0]
    }

    /// Returns the name in tables.
    pub fn label(self) -> &'static str {
        self.names()[1]
    }

    /// Returns the unit in tables. Values in files have the same unit, except shares, which are fractions.
    pub fn unit(self) -> &'static str {
        self.names()[2]
    }

    /// Returns whether the metric is a share of good pixels, shown in per cent; all others are errors.
    pub fn is_share(self) -> bool {
        self.unit() == "%"
    }

    /// Returns the ratio below which a pixel counts for a share.
    fn bound(self) -> Option<f64> {
        Some(match self {
            Self::Delta102 => 1.02,
            Self::Delta105 => 1.05,
            Self::Delta110 => 1.10,
            Self::Delta1 => 1.25,
            Self::Delta2 => 1.25_f64.powi(2),
            Self::Delta3 => 1.25_f64.powi(3),
            _ => return None,
        })
    }
}

/// Values of all metrics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scores([f64; Metric::ALL.len()]);

impl Default for Scores {
    fn default() -> Self {
        Self([0.0; Metric::ALL.len()])
    }
}

impl Index<Metric> for Scores {
    type Output = f64;

    fn index(&self, metric: Metric) -> &f64 {
        &self.0[metric as usize]
    }
}

impl IndexMut<Metric> for Scores {
    fn index_mut(&mut self, metric: Metric) -> &mut f64 {
        &mut self.0[metric as usize]
    }
}

impl Scores {
    /// Compares a prediction with the truth.
    ///
    /// # Errors
    /// Maps of different sizes, or a truth without any depth.
    pub fn of(prediction: &DepthMap, truth: &DepthMap, rules: &Rules) -> Result<Self> {
        let size = |map: &DepthMap| (map.width(), map.height());
        if size(prediction) != size(truth) {
            return Err(Error::shape(format!(
                "the prediction is {}x{} but the truth {}x{}",
                prediction.width(),
                prediction.height(),
                truth.width(),
                truth.height()
            )));
        }
        let mut sums = Self::default();
        let mut count = 0.0;
        for (&p, &d) in prediction.values().iter().zip(truth.values()) {
            if d == 0.0 {
                continue;
            }
            count += 1.0;
            sums.add_pixel(f64::from(p), f64::from(d), rules.floor);
        }
        if count == 0.0 {
            return Err(Error::shape("the true depth map has no measurement"));
        }
        let mut means = sums.map(|_, sum| sum / count);
        for root in [Metric::Rmse, Metric::Irmse, Metric::RmseLog] {
            means[root] = means[root].sqrt();
        }
        means[Metric::See] = edge::soft_edge_error(prediction, truth, rules).unwrap_or(f64::NAN);
        Ok(means)
    }

    fn add_pixel(&mut self, p: f64, d: f64, floor: f64) {
        let error = p - d;
        let p = p.max(floor);
        let inverse = 1e3 * (1.0 / p - 1.0 / d);
        let log = (p / d).ln();
        let ratio = (p / d).max(d / p);
        for metric in Metric::ALL {
            self[metric] += match metric {
                Metric::Rmse => error * error,
                Metric::Mae => error.abs(),
                Metric::Irmse => inverse * inverse,
                Metric::Imae => inverse.abs(),
                Metric::Rel => error.abs() / d,
                Metric::Log10 => log.abs() / std::f64::consts::LN_10,
                Metric::RmseLog => log * log,
                Metric::See => 0.0,
                share => f64::from(share.bound().is_some_and(|bound| ratio < bound)),
            };
        }
    }

    /// Applies a function to every value.
    #[must_use]
    pub fn map(self, f: impl Fn(Metric, f64) -> f64) -> Self {
        let mut changed = self;
        for metric in Metric::ALL {
            changed[metric] = f(metric, self[metric]);
        }
        changed
    }
}

impl Serialize for Scores {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        let finite = |m: Metric| Some(self[m]).filter(|v| v.is_finite());
        serializer.collect_map(Metric::ALL.into_iter().map(|m| (m.key(), finite(m))))
    }
}

impl<'de> Deserialize<'de> for Scores {
    /// Metrics that are null or absent are NaN.
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        let values = BTreeMap::<String, Option<f64>>::deserialize(deserializer)?;
        let value = |m: Metric| values.get(m.key()).copied().flatten();
        Ok(Self::default().map(|m, _| value(m).unwrap_or(f64::NAN)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(values: &[f32]) -> DepthMap {
        DepthMap::new(values.len(), 1, values.to_vec()).unwrap()
    }

    fn of(prediction: &[f32], truth: &[f32]) -> Scores {
        Scores::of(&map(prediction), &map(truth), &Rules::default()).unwrap()
    }

    #[test]
    fn scores_match_a_hand_calculation() {
        // Errors 0.5, 0, -2 at depths 1, 2, 4; the last pixel has no truth.
        let scores = of(&[1.5, 2.0, 2.0, 9.0], &[1.0, 2.0, 4.0, 0.0]);
        let close = |metric: Metric, expected: f64| {
            assert!(
                (scores[metric] - expected).abs() < 1e-9,
                "{metric:?}: {}",
                scores[metric]
            );
        };
        close(Metric::Rmse, ((0.25_f64 + 4.0) / 3.0).sqrt());
        close(Metric::Mae, 2.5 / 3.0);
        close(Metric::Rel, (0.5 + 0.5) / 3.0);
        // 1/1.5 - 1 and 1/2 - 1/4 in 1/m.
        close(Metric::Imae, 1e3 * (1.0 / 3.0 + 0.25) / 3.0);
        close(Metric::Irmse, 1e3 * ((1.0 / 9.0 + 0.0625) / 3.0_f64).sqrt());
        close(Metric::Log10, (1.5_f64.log10() + 2.0_f64.log10()) / 3.0);
        // Ratios 1.5, 1, 2 against 1.02 to 1.25, 1.5625, 1.953125.
        close(Metric::Delta102, 1.0 / 3.0);
        close(Metric::Delta1, 1.0 / 3.0);
        close(Metric::Delta2, 2.0 / 3.0);
        close(Metric::Delta3, 2.0 / 3.0);
    }

    #[test]
    fn a_prediction_of_nothing_counts_as_the_floor_in_ratios() {
        let scores = of(&[0.0], &[1.0]);
        assert_eq!(scores[Metric::Rmse], 1.0);
        assert!((scores[Metric::Imae] - 1e3 * 999.0).abs() < 1e-6);
        assert!((scores[Metric::Log10] - 3.0).abs() < 1e-12);
    }

    #[test]
    fn scores_survive_a_file() {
        let scores = of(&[1.5, 2.0], &[1.5, 2.0]);
        let text = serde_json::to_string(&scores).unwrap();
        assert!(text.contains("\"delta_1.02\":1.0"), "{text}");
        assert_eq!(serde_json::from_str::<Scores>(&text).unwrap(), scores);
        // A map without edges has no soft edge error.
        let flat = of(&[1.0, 1.0], &[1.0, 1.0]);
        let text = serde_json::to_string(&flat).unwrap();
        assert!(text.contains("\"see\":null"), "{text}");
        assert!(serde_json::from_str::<Scores>(&text).unwrap()[Metric::See].is_nan());
    }
}
