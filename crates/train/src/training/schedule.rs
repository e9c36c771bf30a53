//! Schedules of the learning rate.

use serde::{Deserialize, Serialize};

/// A schedule of the learning rate; `progress` below is the fraction of steps done.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", tag = "kind", deny_unknown_fields)]
pub enum Schedule {
    /// The full rate until `at`, then the rate times `factor`.
    Step {
        /// Progress at which the rate drops.
        at: f64,
        /// Factor on the rate after the drop.
        factor: f64,
    },
    /// Multiplies the rate by `factor` after each fraction `every` of the steps.
    Steps {
        /// Progress between drops.
        every: f64,
        /// Factor on the rate at each drop.
        factor: f64,
    },
    /// A linear warm-up, then half a cosine down to 0.
    Cosine {
        /// Progress at which the full rate is reached.
        warmup: f64,
    },
}

impl Default for Schedule {
    /// Returns the schedule of the paper: 1e-4 for 30 of 100 epochs, then 1e-5.
    fn default() -> Self {
        Self::Step {
            at: 0.3,
            factor: 0.1,
        }
    }
}

impl Schedule {
    /// Returns the fraction of the full rate at `progress` in `[0, 1]`.
    pub fn factor(self, progress: f64) -> f64 {
        match self {
            Self::Step { at, factor } => {
                if progress < at {
                    1.0
                } else {
                    factor
                }
            }
            Self::Steps { every, factor } => {
                // Tolerates the rounding of progress, so that a drop is not a step late.
                let drops = (progress / every.max(1e-9) + 1e-9).floor();
                factor.powf(drops)
            }
            Self::Cosine { warmup } if progress < warmup => progress / warmup,
            Self::Cosine { warmup } => {
                let remaining = (progress - warmup) / (1.0 - warmup).max(1e-9);
                0.5 * (1.0 + (std::f64::consts::PI * remaining).cos())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_the_papers() {
        let rate = |epoch: f64| 1e-4 * Schedule::default().factor(epoch / 100.0);
        assert!((rate(29.9) - 1e-4).abs() < 1e-12);
        assert!((rate(30.0) - 1e-5).abs() < 1e-12);
    }

    #[test]
    fn steps_follow_each_other() {
        let schedule = Schedule::Steps {
            every: 0.25,
            factor: 0.2,
        };
        for (progress, rate) in [(0.1, 1.0), (0.2499, 1.0), (0.25, 0.2), (0.75, 0.008)] {
            assert!(
                (schedule.factor(progress) - rate).abs() < 1e-12,
                "{progress}"
            );
        }
    }

    #[test]
    fn cosine_rises_then_falls_to_zero() {
        let schedule = Schedule::Cosine { warmup: 0.1 };
        assert!((schedule.factor(0.05) - 0.5).abs() < 1e-12);
        assert!((schedule.factor(0.1) - 1.0).abs() < 1e-12);
        assert!((schedule.factor(0.55) - 0.5).abs() < 1e-12);
        assert!(schedule.factor(1.0).abs() < 1e-12);
    }
}
