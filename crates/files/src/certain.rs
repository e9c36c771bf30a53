//! Limits of the uncertainty of depths.

use crate::DepthMap;
use crate::error::Result;

/// Largest standard deviations of depths that are kept; no limit by default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DeviationLimits {
    /// Limit in the unit of the depths.
    pub absolute: Option<f32>,
    /// Limit as a share of the depth.
    pub relative: Option<f32>,
}

impl DeviationLimits {
    /// Default relative limit of clouds, surfaces and workspaces: pixels whose standard deviation is a larger share of
    /// their depth are left out.
    pub const MEASURED: f64 = 0.1;

    /// Whether a standard deviation is above a limit.
    pub fn exclude(&self, depth: f32, sigma: f32) -> bool {
        let above = |value: f32, most: Option<f32>| most.is_some_and(|most| value > most);
        depth > 0.0 && (above(sigma, self.absolute) || above(sigma / depth, self.relative))
    }

    /// Whether there is any limit.
    pub fn is_any(&self) -> bool {
        *self != Self::default()
    }
}

/// Replaces depths whose standard deviation is above a limit by 0, no depth. Returns the map and the number of replaced
/// depths. Both maps have the same size; a pixel without a standard deviation keeps its depth.
///
/// # Errors
/// None for maps of the same size.
pub fn without_uncertain(
    depth: DepthMap,
    deviations: &DepthMap,
    limits: &DeviationLimits,
) -> Result<(DepthMap, usize)> {
    let (width, height) = (depth.width(), depth.height());
    let mut values = depth.into_values();
    let mut count = 0;
    for (value, sigma) in values.iter_mut().zip(deviations.values()) {
        if limits.exclude(*value, *sigma) {
            *value = 0.0;
            count += 1;
        }
    }
    Ok((DepthMap::new(width, height, values)?, count))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depths_above_a_limit_are_left_out_and_counted() {
        let map = |values: [f32; 5]| DepthMap::new(5, 1, values.to_vec()).unwrap();
        let deviations = map([0.1, 0.2, 0.3, 0.9, 0.0]);
        let without = |absolute, relative| {
            let depth = map([1.0, 2.0, 4.0, 0.0, 5.0]);
            let limits = DeviationLimits { absolute, relative };
            without_uncertain(depth, &deviations, &limits).unwrap()
        };
        let all = map([1.0, 2.0, 4.0, 0.0, 5.0]);
        assert_eq!(without(None, None), (all.clone(), 0));
        assert_eq!(
            without(Some(0.2), None),
            (map([1.0, 2.0, 0.0, 0.0, 5.0]), 1)
        );
        assert_eq!(
            without(None, Some(0.09)),
            (map([0.0, 0.0, 4.0, 0.0, 5.0]), 2)
        );
        assert_eq!(
            without(Some(0.2), Some(0.09)),
            (map([0.0, 0.0, 0.0, 0.0, 5.0]), 3)
        );
    }
}
