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

/// A space, and the unit of depths in it.
///
/// Logarithms are those of depths in units of the points' geometric mean: a scaled scene has the same values, whatever the basis
/// functions are. Without that, only a constant among them would make the fit scale equivariant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthScale {
    space: Space,
    /// Metres.
    unit: f64,
}

impl DepthScale {
    /// That of points with these depths, in metres.
    pub fn of_points(space: Space, depths: &[f32]) -> Self {
        let unit = match space {
            Space::Depth | Space::Inverse => 1.0,
            Space::Log => {
                let sum: f64 = depths.iter().map(|&d| f64::from(d).ln()).sum();
                (sum / depths.len().max(1) as f64).exp()
            }
        };
        Self { space, unit }
    }

    /// The space.
    pub fn space(self) -> Space {
        self.space
    }

    /// The fitted value of a positive depth in metres.
    pub fn of(self, depth: f64) -> f64 {
        self.space.of(depth / self.unit)
    }

    /// The depth in metres of a fitted value; inverses at or below 0 are infinitely far.
    pub fn depth(self, value: f64) -> f64 {
        self.unit * self.space.depth(value)
    }

    /// The absolute derivative of depth, in metres, with respect to the fitted value, at a given depth.
    pub fn slope(self, depth: f64) -> f64 {
        self.unit * self.space.slope(depth / self.unit)
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

    #[test]
    fn logarithms_of_a_scaled_scene_are_the_same() {
        let scale = |factor: f32| DepthScale::of_points(Space::Log, &[2.0 * factor, 8.0 * factor]);
        // The geometric mean of 2 and 8 is 4.
        assert!((scale(1.0).of(8.0) - 2.0_f64.ln()).abs() < 1e-12);
        for factor in [0.1, 3.7, 10.0] {
            let (depth, scaled) = (3.0, 3.0 * f64::from(factor));
            assert!((scale(1.0).of(depth) - scale(factor).of(scaled)).abs() < 1e-6);
            assert!(
                (scale(factor).depth(scale(factor).of(scaled)) - scaled).abs() < 1e-12 * scaled
            );
            // The derivative of a logarithm is the inverse.
            assert!((scale(factor).slope(scaled) - scaled).abs() < 1e-12 * scaled);
        }
    }
}
