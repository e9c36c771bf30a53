//! The positional encoding (paper section 3.2, equation 5).

/// The number of channels for E = `octaves`: 2 + 2 + 4 (E - 1), or 0 without positional encoding.
pub fn channels(octaves: usize) -> usize {
    4 * octaves
}

/// The half of the encoding that comes from one axis, `2 octaves` values for each position.
///
/// Positions are in pixels, where 0 is the centre of the first pixel; an axis of `length` pixels is mapped to
/// `[-1, 1]` from edge to edge. The coordinate appears twice, as in the formula, then `sin` and `cos` of
/// `2^k pi` times it for k = 0 .. E - 2.
pub fn codes(places: impl IntoIterator<Item = f64>, length: usize, octaves: usize) -> Vec<f32> {
    let mut values = Vec::new();
    for place in places {
        let c = (2.0 * place + 1.0) / length as f64 - 1.0;
        for channel in 0..octaves {
            if channel == 0 {
                values.extend([c as f32; 2]);
                continue;
            }
            let angle = f64::from(1 << (channel - 1)) * std::f64::consts::PI * c;
            values.extend([angle.sin() as f32, angle.cos() as f32]);
        }
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_follow_the_formula() {
        // Position 2 of 4 pixels: 5/4 - 1.
        let (x, pi) = (0.25_f32, std::f32::consts::PI);
        let expected = [
            x,
            x,
            (pi * x).sin(),
            (pi * x).cos(),
            (2.0 * pi * x).sin(),
            (2.0 * pi * x).cos(),
        ];
        let found = codes([2.0], 4, 3);
        assert_eq!(2 * found.len(), channels(3));
        for (a, b) in found.iter().zip(expected) {
            assert!((a - b).abs() < 1e-6, "{a} {b}");
        }
        assert_eq!(channels(5), 20);
        assert!(codes([0.0], 4, 0).is_empty());
        // Between pixels: halfway from 0.25 to 0.75.
        assert_eq!(codes([2.5], 4, 1), [0.5, 0.5]);
    }
}
