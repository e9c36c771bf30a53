//! Depth maps without the pixels that are too uncertain.

use crate::DepthMap;
use crate::error::Result;

/// Returns a depth map without the depths whose standard deviation is above `most`, and how many these are. They become
/// 0, no depth. Both maps have the same size; a pixel without a standard deviation keeps its depth.
///
/// # Errors
/// None for maps of the same size.
pub fn without_uncertain(
    depth: DepthMap,
    deviations: &DepthMap,
    most: f32,
) -> Result<(DepthMap, usize)> {
    let (width, height) = (depth.width(), depth.height());
    let mut values = depth.into_values();
    let mut count = 0;
    for (value, sigma) in values.iter_mut().zip(deviations.values()) {
        if *value > 0.0 && *sigma > most {
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
    fn depths_above_the_limit_are_left_out_and_counted() {
        let map = |values: [f32; 5]| DepthMap::new(5, 1, values.to_vec()).unwrap();
        let depth = map([1.0, 2.0, 3.0, 0.0, 5.0]);
        let deviations = map([0.1, 0.2, 0.3, 0.9, 0.0]);
        let (found, count) = without_uncertain(depth, &deviations, 0.2).unwrap();
        assert_eq!(found, map([1.0, 2.0, 0.0, 0.0, 5.0]));
        assert_eq!(count, 1);
    }
}
