//! Paired difference between two methods on the same frames.

use lsdc_core::fit::student_t;
use serde::{Deserialize, Serialize};

/// The mean difference of paired values and its 95 % confidence interval (Student's t).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PairedDifference {
    /// Mean of the second minus the first.
    pub mean: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
    /// Share of the pairs in which the second value is smaller.
    pub smaller: f64,
    /// Number of pairs.
    pub pairs: usize,
}

impl PairedDifference {
    /// Compares pairs of (first, second); `None` for fewer than two finite differences.
    pub fn of(pairs: impl Iterator<Item = (f64, f64)>) -> Option<Self> {
        let differences: Vec<f64> = pairs
            .map(|(a, b)| b - a)
            .filter(|d| d.is_finite())
            .collect();
        let n = differences.len();
        if n < 2 {
            return None;
        }
        let mean = differences.iter().sum::<f64>() / n as f64;
        let squares: f64 = differences.iter().map(|d| (d - mean).powi(2)).sum();
        let error = (squares / (n as f64 - 1.0) / n as f64).sqrt();
        let half = student_t::bound(0.95, n as f64 - 1.0) * error;
        Some(Self {
            mean,
            low: mean - half,
            high: mean + half,
            smaller: differences.iter().filter(|d| **d < 0.0).count() as f64 / n as f64,
            pairs: n,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_interval_of_a_known_sample() {
        // Differences 1, 2, 3, 4, 5: mean 3, standard error sqrt(2.5 / 5), t(4) = 2.776.
        let pairs = (1..=5).map(|d| (10.0, 10.0 + f64::from(d)));
        let difference = PairedDifference::of(pairs).unwrap();
        assert_eq!(
            (difference.mean, difference.smaller, difference.pairs),
            (3.0, 0.0, 5)
        );
        assert!((difference.high - (3.0 + 2.7764 * 0.5_f64.sqrt())).abs() < 1e-3);
        assert!(PairedDifference::of([(1.0, 2.0)].into_iter()).is_none());
    }
}
