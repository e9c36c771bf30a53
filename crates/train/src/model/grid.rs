//! Interpolation of features between pixel centres.

use crate::ops::interpolate::{Between, PixelReads, cell, interpolate, interpolate_pixels};
use burn::tensor::Tensor;
use lsdc_core::bilinear::neighbours;

/// Reads features `[batch, h, w, channels]` at pixels of an image of `size` (height, width).
///
/// `pixels[b]` lists `y * width + x`, with the same length for each image; the result is `[batch * pixels, channels]`.
pub(super) fn sample(features: Tensor<4>, size: (usize, usize), pixels: &[Vec<u32>]) -> Tensor<2> {
    let [_, h, w, _] = features.dims();
    let reads = PixelReads::some([h, w], axes(size, (h, w)), pixels.to_vec());
    interpolate_pixels(features, reads)
}

/// Reads features `[1, h, w, channels]` at positions (u, v) of an image of `size` (height, width):
/// `[places, channels]`.
pub(super) fn sample_places(
    features: Tensor<4>,
    size: (usize, usize),
    places: &[[f64; 2]],
) -> Tensor<2> {
    let [images, h, w, channels] = features.dims();
    let cell = |&[u, v]: &[f64; 2]| cell(w, between(v, size.0, h), between(u, size.1, w));
    let table = features.reshape([images, h * w, channels]);
    interpolate(table, vec![places.iter().map(cell).collect()])
}

/// Upsamples features `[batch, h, w, channels]` bilinearly to `size` (height, width).
pub(super) fn enlarged(features: Tensor<4>, size: (usize, usize)) -> Tensor<4> {
    let [batch, h, w, channels] = features.dims();
    let reads = PixelReads::every([h, w], batch, axes(size, (h, w)));
    interpolate_pixels(features, reads).reshape([batch, size.0, size.1, channels])
}

/// Returns the positions of the rows and columns of images of a size (height, width) in maps of another.
fn axes(from: (usize, usize), to: (usize, usize)) -> [Vec<Between>; 2] {
    [(from.0, to.0), (from.1, to.1)].map(|(from, to)| {
        let pixels = 0..from;
        pixels.map(|i| between(i as f64, from, to)).collect()
    })
}

fn between(place: f64, from: usize, to: usize) -> Between {
    let (low, high, share) = neighbours(place, from, to);
    (low, high, share as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::{Device, TensorData};

    #[test]
    fn enlargement_is_exact_on_ramps_inside() {
        let ramp: Vec<f32> = (0..12)
            .map(|i| (i % 4) as f32 + 10.0 * (i / 4) as f32)
            .collect();
        let map = Tensor::<4>::from_data(TensorData::new(ramp, [1, 3, 4, 1]), &Device::flex());
        let large: Vec<f32> = enlarged(map, (6, 8)).into_data().iter().collect();
        // Pixel centres are at (i + 0.5) / 2 - 0.5; outside the outer ones, values are constant.
        let place = |i: usize, last: f32| (f32::midpoint(i as f32, 0.5) - 0.5).clamp(0.0, last);
        for (i, value) in large.into_iter().enumerate() {
            let expected = place(i % 8, 3.0) + 10.0 * place(i / 8, 2.0);
            assert!((value - expected).abs() < 1e-5, "{i}: {value} {expected}");
        }
    }
}
