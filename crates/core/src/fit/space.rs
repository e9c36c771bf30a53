//! The function of depth that the basis functions represent.

use serde::{Deserialize, Serialize};

/// The function of depth that is fitted as a weighted sum of basis functions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Space {
    /// Depth itself (as in the paper).
    #[default]
    Depth,
    /// Its natural logarithm, which emphasises relative errors.
    Log,
    /// Its inverse, in 1/m, which emphasises near depths.
    Inverse,
}

impl Space {
    /// All spaces.
    pub const ALL: [Self; 3] = [Self::Depth, Self::Log, Self::Inverse];

    /// The name in configs and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Depth => "depth",
            Self::Log => "log",
            Self::Inverse => "inverse",
        }
    }

    /// The fitted value of a positive depth in metres.
    pub fn of(self, depth: f64) -> f64 {
        match self {
            Self::Depth => depth,
            Self::Log => depth.ln(),
            Self::Inverse => 1.0 / depth,
        }
    }

    /// The depth in metres of a fitted value; inverses at or below 0 are infinitely far.
    pub fn depth(self, value: f64) -> f64 {
        match self {
            Self::Depth => value,
            Self::Log => value.exp(),
            Self::Inverse if value > 0.0 => 1.0 / value,
            Self::Inverse => f64::INFINITY,
        }
    }

    /// The absolute derivative of depth, in metres, with respect to the fitted value, at a given depth.
    pub fn slope(self, depth: f64) -> f64 {
        match self {
            Self::Depth => 1.0,
            Self::Log => depth,
            Self::Inverse => depth * depth,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depths_come_back_and_slopes_are_derivatives() {
        for space in Space::ALL {
            for depth in [0.1, 1.0, 7.3, 80.0] {
                let value = space.of(depth);
                assert!((space.depth(value) - depth).abs() < 1e-12 * depth);
                let step = 1e-6 * value.abs().max(1.0);
                let change = (space.depth(value + step) - space.depth(value - step)) / (2.0 * step);
                assert!((change.abs() - space.slope(depth)).abs() < 1e-5 * space.slope(depth));
            }
        }
        assert_eq!(Space::Inverse.depth(-0.1), f64::INFINITY);
    }
}
