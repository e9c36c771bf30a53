//! The difference of two methods on the same frames.

use serde::{Deserialize, Serialize};

/// The mean difference of paired values and its 95 % confidence interval (Student's t).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Difference {
    /// Mean of second minus first.
    pub mean: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
    /// Share of the pairs in which the second value is smaller.
    pub smaller: f64,
    /// The number of pairs.
    pub pairs: usize,
}

impl Difference {
    /// Compares pairs of (first, second); `None` for fewer than two finite ones.
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
        let half = student(n - 1) * error;
        Some(Self {
            mean,
            low: mean - half,
            high: mean + half,
            smaller: differences.iter().filter(|d| **d < 0.0).count() as f64 / n as f64,
            pairs: n,
        })
    }
}

/// The 97.5 % point of Student's t distribution, by bisection of its closed form for whole degrees
/// of freedom (Abramowitz and Stegun 26.7.3 and 26.7.4).
fn student(freedom: usize) -> f64 {
    let (mut low, mut high) = (0.0, 13.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if inside(middle, freedom) < 0.95 {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

/// The probability that |t| is below `t`.
fn inside(t: f64, freedom: usize) -> f64 {
    let n = freedom as f64;
    let angle = (t / n.sqrt()).atan();
    let (sin, cos) = angle.sin_cos();
    let odd = freedom % 2 == 1;
    // sum of cos^k times the ratio of the products of the numbers before
    let (mut term, mut sum) = if odd { (cos, cos) } else { (1.0, 1.0) };
    let mut k = if odd { 3 } else { 2 };
    while k < freedom {
        term *= cos * cos * (k as f64 - 1.0) / k as f64;
        sum += term;
        k += 2;
    }
    if !odd {
        return sin * sum;
    }
    let tail = if freedom == 1 { 0.0 } else { sin * sum };
    2.0 / std::f64::consts::PI * (angle + tail)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn t_has_the_points_of_published_tables() {
        for (freedom, point) in [
            (1, 12.706),
            (2, 4.303),
            (3, 3.182),
            (4, 2.776),
            (9, 2.262),
            (10, 2.228),
            (30, 2.042),
            (120, 1.980),
        ] {
            assert!(
                (student(freedom) - point).abs() < 6e-4,
                "{freedom}: {}",
                student(freedom)
            );
        }
        assert!((student(100_000) - 1.960).abs() < 1e-3);
    }

    #[test]
    fn the_interval_of_a_known_sample() {
        // Differences 1, 2, 3, 4, 5: mean 3, standard error sqrt(2.5 / 5), t(4) = 2.776.
        let pairs = (1..=5).map(|d| (10.0, 10.0 + f64::from(d)));
        let difference = Difference::of(pairs).unwrap();
        assert_eq!(
            (difference.mean, difference.smaller, difference.pairs),
            (3.0, 0.0, 5)
        );
        assert!((difference.high - (3.0 + 2.7764 * 0.5_f64.sqrt())).abs() < 1e-3);
        assert!(Difference::of([(1.0, 2.0)].into_iter()).is_none());
    }
}
