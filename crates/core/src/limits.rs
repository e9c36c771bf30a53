//! Limits of depths far outside the range of the observations.

/// Depths are at most those of the farthest observation times this factor, and at least those of the nearest divided by it. It is
/// relative, so that scaling the observations scales the result.
pub const RANGE: f32 = 10.0;

/// Depths nearer than the nearest observation times this factor are continued in inverse depth. Of 0.5, 0.7, 0.8 and 1, the largest
/// with which the errors of five points in rooms do not increase.
const NEAR: f32 = 0.7;

/// The limits of a map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct DepthLimits {
    pub(crate) lowest: f32,
    pub(crate) highest: f32,
    /// Where the continuation in inverse depth begins.
    near: f32,
}

impl DepthLimits {
    /// The limits for observations of depths `low` to `high`.
    pub(crate) fn new((low, high): (f32, f32)) -> Self {
        Self {
            lowest: low / RANGE,
            highest: high * RANGE,
            near: NEAR * low,
        }
    }

    /// Limits a fitted depth z. Below the depth a where it begins, the continuation is `a^2 / (2 a - z)`: its value and slope are
    /// those of z at a, but it is linear in inverse depth, as planes seen by a pinhole camera are. z itself, extrapolated in the
    /// foreground of a street, would reach 0 and below.
    pub(crate) fn apply(self, depth: f32) -> f32 {
        let depth = if depth < self.near {
            self.near * self.near / (2.0 * self.near - depth)
        } else {
            depth
        };
        depth.clamp(self.lowest, self.highest)
    }

    /// Whether a limited depth differs from the fitted one.
    pub(crate) fn changed(self, depth: f32) -> bool {
        depth < self.near || depth >= self.highest
    }

    /// The distance of a limited depth from the fitted one below: at [`Self::lowest`], a lower bound of it.
    pub(crate) fn raised_by(self, depth: f32) -> f32 {
        (self.near - depth).max(0.0).powi(2) / depth
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depths_below_the_observations_are_continued_in_inverse_depth() {
        let limits = DepthLimits::new((2.0, 8.0));
        for unchanged in [1.4, 2.0, 50.0] {
            assert_eq!(limits.apply(unchanged), unchanged);
            assert!(!limits.changed(unchanged));
            assert_eq!(limits.raised_by(unchanged), 0.0);
        }
        // Equal steps of depth are equal steps of inverse depth, the first of the same slope.
        let inverse = |depth: f32| limits.apply(depth).recip();
        let step = 0.01 / (1.4 * 1.4);
        for depth in [1.39, 0.7, 0.0, -0.7] {
            assert!((inverse(depth - 0.01) - inverse(depth) - step).abs() < 1e-6);
            let limited = limits.apply(depth);
            assert!(limits.changed(limited));
            assert!((limits.raised_by(limited) - (limited - depth)).abs() < 1e-5);
        }
        assert_eq!(limits.apply(0.0), 0.7);
        assert_eq!((limits.apply(-1e9), limits.apply(1e9)), (0.2, 80.0));
        assert!(limits.changed(0.2) && limits.changed(80.0));
        // Not a number stays one.
        assert!(limits.apply(f32::NAN).is_nan());
    }
}
