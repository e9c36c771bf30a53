//! The positional encoding (paper section 3.2, equation 5).

/// The number of channels for E = `octaves`: 2 + 2 + 4 (E - 1), or 0 without position.
pub(super) fn channels(octaves: usize) -> usize {
    if octaves == 0 { 0 } else { 4 * octaves }
}

/// Encodes pixels of an image of `size` (height, width), `channels(octaves)` values each.
///
/// Pixel centres are mapped to `[-1, 1]`; the raw coordinates come twice, as in the formula, then
/// `sin` and `cos` of `2^k pi` times each coordinate for k = 0 .. E - 2.
pub fn encode(size: (usize, usize), pixels: &[u32], octaves: usize) -> Vec<f32> {
    if octaves == 0 {
        return Vec::new();
    }
    let (rows, columns) = (axis(size.0, octaves), axis(size.1, octaves));
    let stride = 2 * octaves;
    let mut values = Vec::with_capacity(pixels.len() * 2 * stride);
    for &pixel in pixels {
        let (y, x) = (pixel as usize / size.1, pixel as usize % size.1);
        values.extend_from_slice(&columns[x * stride..][..stride]);
        values.extend_from_slice(&rows[y * stride..][..stride]);
    }
    values
}

/// For every pixel of an axis: the coordinate twice, then its sines and cosines.
pub(super) fn axis(length: usize, octaves: usize) -> Vec<f32> {
    (0..length)
        .map(|i| (2 * i + 1) as f64 / length as f64 - 1.0)
        .flat_map(|c| {
            let waves = (0..octaves - 1).flat_map(move |k| {
                let angle = f64::from(1 << k) * std::f64::consts::PI * c;
                [angle.sin() as f32, angle.cos() as f32]
            });
            [c as f32, c as f32].into_iter().chain(waves)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_follow_the_formula() {
        let code = encode((2, 4), &[6], 3);
        assert_eq!(code.len(), channels(3));
        // Pixel (x = 2, y = 1): x = 5/4 - 1 = 0.25, y = 3/2 - 1 = 0.5.
        let (x, y, pi) = (0.25_f32, 0.5_f32, std::f32::consts::PI);
        let expected = [
            x,
            x,
            (pi * x).sin(),
            (pi * x).cos(),
            (2.0 * pi * x).sin(),
            (2.0 * pi * x).cos(),
            y,
            y,
            (pi * y).sin(),
            (pi * y).cos(),
            (2.0 * pi * y).sin(),
            (2.0 * pi * y).cos(),
        ];
        for (a, b) in code.iter().zip(expected) {
            assert!((a - b).abs() < 1e-6, "{a} {b}");
        }
        assert_eq!(channels(5), 20);
        assert!(encode((2, 4), &[0], 0).is_empty());
    }
}
