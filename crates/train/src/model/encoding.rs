//! Positional encoding of pixels.

pub(super) use lsdc_core::network::channels;
use lsdc_core::network::codes;

/// Encodes pixels of an image of `size` (height, width), `4 octaves` values each.
pub fn encode(size: (usize, usize), pixels: &[u32], octaves: usize) -> Vec<f32> {
    let axis = |length: usize| codes((0..length).map(|i| i as f64), length, octaves);
    let (rows, columns) = (axis(size.0), axis(size.1));
    let stride = 2 * octaves;
    let mut values = Vec::with_capacity(pixels.len() * 2 * stride);
    for &pixel in pixels {
        let (y, x) = (pixel as usize / size.1, pixel as usize % size.1);
        values.extend_from_slice(&columns[x * stride..][..stride]);
        values.extend_from_slice(&rows[y * stride..][..stride]);
    }
    values
}

/// Encodes positions (u, v) of an image of `size` (height, width), `4 octaves` values each.
pub(super) fn encode_places(size: (usize, usize), places: &[[f64; 2]], octaves: usize) -> Vec<f32> {
    let code = |&[u, v]: &[f64; 2]| {
        let mut code = codes([u], size.1, octaves);
        code.extend(codes([v], size.0, octaves));
        code
    };
    places.iter().flat_map(code).collect()
}
