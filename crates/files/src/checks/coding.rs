//! Undeclared integer codings of depths.

use std::collections::HashSet;

/// Whether all positive numbers are coded as in SUN RGB-D: 16-bit millimetres, rotated left by 3
/// (`SUNRGBDtoolbox/read3dPoints.m`). Depths below 8.192 m are then multiples of 8, and no larger factor is common to all.
/// Millimetres in steps of 8 would look the same if they took few values, so many distinct numbers are required.
pub fn is_rotated(values: &[f32]) -> bool {
    /// Distinct numbers above this count have no common factor by chance.
    const MANY: usize = 32;
    /// Largest share of depths beyond 8.192 m.
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
        // Most maps are rejected here, after a few pixels.
        if far as f64 > FAR * values.len() as f64 {
            return false;
        }
    }
    common == 8 && different.len() >= MANY && far as f64 <= FAR * all as f64
}

/// Rotates the bits back, to millimetres.
pub fn rotate_back(values: &mut [f32]) {
    for value in values.iter_mut().filter(|v| **v > 0.0) {
        *value = f32::from((*value as u16).rotate_right(3));
    }
}

/// Returns the greatest common divisor.
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
