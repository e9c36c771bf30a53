//! Sky in the relative inverse depths that Depth Anything predicts from an image.

/// Largest inverse depth of sky, relative to the nearest.
const SKY: f32 = 0.01;
/// Smallest share of sky pixels of an image with sky.
const SKY_AREA: f32 = 0.02;

/// The scale of the relative inverse depths of an image, and whether it shows sky. Depth Anything V2 was trained with a loss
/// that does not depend on the shift of inverse depths, but with infinity at 0 (Yang et al. 2024).
#[doc(hidden)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InverseDepthScale {
    /// The inverse depth of near things: the 95th percentile of those above 0.
    pub nearest: f32,
    /// Whether the image shows sky.
    pub has_sky: bool,
}

impl InverseDepthScale {
    /// The scale of these inverse depths; `None` if all are at infinity.
    pub fn of(inverse: &[f32]) -> Option<Self> {
        let mut sorted = inverse.to_vec();
        sorted.sort_unstable_by(f32::total_cmp);
        // Excludes points at infinity: there may be little below a wide sky.
        let finite = sorted.partition_point(|value| *value <= 0.0);
        let nearest = *sorted.get(finite + (sorted.len() - finite) * 95 / 100)?;
        let sky = sorted.partition_point(|value| *value < SKY * nearest);
        Some(Self {
            nearest,
            has_sky: sky as f32 > SKY_AREA * inverse.len() as f32,
        })
    }

    /// Whether a pixel with this inverse depth shows sky.
    pub fn is_sky(&self, inverse: f32) -> bool {
        self.has_sky && inverse < SKY * self.nearest
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sky_is_wide_and_at_infinity() {
        let mut inverse: Vec<f32> = (0..97).map(|i| 1.0 + i as f32).collect();
        inverse.extend([0.0, 0.5, 2.0]);
        let scale = InverseDepthScale::of(&inverse).unwrap();
        // 99 values are above 0; 94 of them are smaller.
        assert_eq!((scale.nearest, scale.has_sky), (93.0, false));
        assert!(!scale.is_sky(0.0));
        inverse[..2].fill(0.9);
        let scale = InverseDepthScale::of(&inverse).unwrap();
        assert!(scale.has_sky && scale.is_sky(0.92) && !scale.is_sky(0.94));
        assert_eq!(InverseDepthScale::of(&[0.0; 9]), None);
    }
}
