//! Positional encoding of pixels.

use burn::tensor::{Device, Int, Tensor, TensorData};
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

/// Encodes pixels of images like [`encode`] on a device, `[pixels, 4 octaves]`: for GPUs, to which the pixels are a twentieth
/// of the codes.
pub(super) fn encode_on_device(
    size: (usize, usize),
    pixels: &[Vec<u32>],
    octaves: usize,
    device: &Device,
) -> Tensor<2> {
    let axis = |length: usize| {
        let codes = codes((0..length).map(|i| i as f64), length, octaves);
        Tensor::<2>::from_data(TensorData::new(codes, [length, 2 * octaves]), device)
    };
    let pixels: Vec<i32> = pixels.iter().flatten().map(|&pixel| pixel as i32).collect();
    let count = pixels.len();
    let pixels = Tensor::<1, Int>::from_data(TensorData::new(pixels, [count]), device);
    let width = size.1 as i32;
    let (x, y) = (pixels.clone() % width, pixels / width);
    Tensor::cat(
        vec![axis(size.1).select(0, x), axis(size.0).select(0, y)],
        1,
    )
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
