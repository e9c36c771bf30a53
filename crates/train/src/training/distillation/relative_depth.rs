//! Depths of a photograph from its relative inverse depth, with unknown scale and shift.

use lsdc_core::sky::InverseDepthScale;
use lsdc_rng::Rng;

/// Depths up to scale, with their standard deviations.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct RelativeDepths {
    /// Depths; 0 in the sky.
    pub depths: Vec<f32>,
    pub deviations: Vec<f32>,
}

impl RelativeDepths {
    fn none(count: usize) -> Self {
        Self {
            depths: vec![0.0; count],
            deviations: vec![0.0; count],
        }
    }
}

/// Shift of images with sky, relative to the nearest inverse depths: the median of 74 outdoor laser scans.
const SHIFT_OUTDOORS: f32 = 0.035;
/// Range of the shifts of other images: nine of ten of 31 rooms of NYU have at least 0.2, half of them 0.43. The shifts between
/// rooms and streets are unknown, so each image gets a random one, log-uniformly.
const SHIFTS: [f32; 2] = [0.05, 0.6];
/// Standard deviation of inverse depths, relative to the nearest.
const DEVIATION: f32 = 0.02;

/// Returns depths 1 / (inverse + shift), in units of the nearest.
pub(super) fn relative_depths(inverse: &[f32], rng: &mut Rng) -> RelativeDepths {
    let Some(scale) = InverseDepthScale::of(inverse) else {
        return RelativeDepths::none(inverse.len());
    };
    let shift = if scale.has_sky {
        SHIFT_OUTDOORS
    } else {
        let [least, most] = SHIFTS.map(f32::ln);
        rng.range(least, most).exp()
    };
    let depths: Vec<f32> = inverse
        .iter()
        .map(|&value| {
            if scale.is_sky(value) {
                0.0
            } else {
                (value / scale.nearest + shift).recip()
            }
        })
        .collect();
    // To first order: the derivative of 1 / x is -1 / x^2.
    let deviations = depths.iter().map(|depth| DEVIATION * depth * depth);
    RelativeDepths {
        deviations: deviations.collect(),
        depths,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sky_has_no_depth_and_fixes_the_shift() {
        let mut rng = Rng::stream(1, &["shift"]);
        let mut inverse = vec![2.0; 90];
        inverse.extend([0.0; 10]);
        inverse[0] = 1.0;
        let RelativeDepths { depths, deviations } = relative_depths(&inverse, &mut rng);
        let expected = [(0.5_f32 + 0.035).recip(), 1.035_f32.recip(), 0.0];
        for (i, expected) in [0, 1, 99].into_iter().zip(expected) {
            assert!((depths[i] - expected).abs() < 1e-6, "{i}: {}", depths[i]);
            assert!((deviations[i] - 0.02 * expected * expected).abs() < 1e-6);
        }
    }

    #[test]
    fn little_below_a_wide_sky_keeps_its_depth() {
        let mut inverse = vec![0.0; 100];
        let of = |inverse: &[f32]| relative_depths(inverse, &mut Rng::stream(1, &["shift"]));
        assert_eq!(of(&inverse), RelativeDepths::none(100));
        inverse[99] = 2.0;
        let depths = of(&inverse).depths;
        assert!((depths[99] - 1.035_f32.recip()).abs() < 1e-6);
        assert!(depths[..99].iter().all(|depth| *depth == 0.0));
    }

    #[test]
    fn without_sky_each_image_has_a_shift_of_its_own() {
        let inverse: Vec<f32> = (1..=100).map(|i| i as f32).collect();
        let ratio = |seed| {
            let found = relative_depths(&inverse, &mut Rng::stream(seed, &["shift"]));
            assert!(found.depths.iter().all(|depth| *depth > 0.0));
            found.depths[0] / found.depths[95]
        };
        // Ratios between 1 / 96 of the nearest and the nearest, for the largest and the smallest shift.
        let bounds = [0.6, 0.05].map(|shift: f32| (1.0 + shift) / (1.0 / 96.0 + shift));
        let ratios: Vec<f32> = (0..50).map(ratio).collect();
        assert!(ratios.iter().all(|r| (bounds[0]..=bounds[1]).contains(r)));
        assert_ne!(ratios[0], ratios[1]);
        assert_eq!(ratios[0], ratio(0));
    }
}
