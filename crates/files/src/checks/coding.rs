//! Codings of depths in integers that no file declares.

use std::collections::HashSet;

/// Whether all positive numbers are those of SUN RGB-D: millimetres of 16 bits, rotated left by 3
/// (`SUNRGBDtoolbox/read3dPoints.m`). Depths below 8.192 m are multiples of 8 then, and no larger factor is common to
/// all. Single steps of 8 in plain millimetres look the same, so there must be many different numbers.
pub fn is_rotated(values: &[f32]) -> bool {
    /// So many different numbers have no factor in common by chance.
    const MANY: usize = 32;
    /// The share of depths beyond 8.192 m.
    const FAR: f64 = 0.1;
    let (mut all, mut far, mut common) = (0_usize, 0_usize, 0_u16);
    let mut different = HashSet::new();
    for &value in values.iter().filter(|v| **v > 0.0) {
        if value > f32::from(u16::MAX) || value.fract() != 0.0 {
            return false;
        }
        let value = value as u16;
        all += 1;
        if value.is_multiple_of(8) {
            common = divisor(common, value);
            if different.len() < MANY {
                different.insert(value);
            }
            continue;
        }
        far += 1;
        // Most maps are decided here, after a few pixels.
        if far as f64 > FAR * values.len() as f64 {
            return false;
        }
    }
    common == 8 && different.len() >= MANY && far as f64 <= FAR * all as f64
}

/// Rotates the bits back: millimetres.
pub fn rotate_back(values: &mut [f32]) {
    for value in values.iter_mut().filter(|v| **v > 0.0) {
        *value = f32::from((*value as u16).rotate_right(3));
    }
}

/// The greatest common divisor.
fn divisor(a: u16, b: u16) -> u16 {
    if b == 0 { a } else { divisor(b, a % b) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotated_bits_are_recognised_and_rotated_back() {
        let millimetres: Vec<u16> = (0..500).map(|i| 601 + 15 * i).chain([0, 8400]).collect();
        let stored = millimetres.iter().map(|d| f32::from(d.rotate_left(3)));
        let mut values: Vec<f32> = stored.collect();
        assert!(is_rotated(&values));
        rotate_back(&mut values);
        assert!(
            values
                .iter()
                .zip(&millimetres)
                .all(|(a, b)| *a == f32::from(*b))
        );
    }

    #[test]
    fn plain_numbers_are_not_taken_for_rotated_ones() {
        let plain = |step: u16| {
            (0..500)
                .map(|i| f32::from(600 + step * i))
                .collect::<Vec<_>>()
        };
        for values in [
            plain(1),
            plain(10),
            plain(100),
            plain(0),
            vec![800.0, 1600.0, 808.0],
        ] {
            assert!(!is_rotated(&values));
        }
    }
}
