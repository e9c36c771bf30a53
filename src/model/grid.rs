//! Where a pixel of the output lies on the feature map: bilinear interpolation between pixel
//! centres (`align_corners = false`).

use crate::bilinear::neighbours;
use burn::tensor::{Device, Int, Tensor, TensorData};

/// Reads features `[batch, h, w, channels]` at pixels of an image of `size` (height, width).
///
/// `pixels[b]` lists `y * width + x`, equally many for each image; the result is
/// `[batch * pixels, channels]`.
pub(super) fn sample(features: Tensor<4>, size: (usize, usize), pixels: &[Vec<u32>]) -> Tensor<2> {
    let [batch, h, w, channels] = features.dims();
    let device = features.device();
    let rows: Vec<_> = (0..size.0).map(|y| neighbours(y, size.0, h)).collect();
    let columns: Vec<_> = (0..size.1).map(|x| neighbours(x, size.1, w)).collect();
    let count: usize = pixels.iter().map(Vec::len).sum();
    let mut indices: [Vec<i32>; 4] = std::array::from_fn(|_| Vec::with_capacity(count));
    let mut weights: [Vec<f32>; 4] = std::array::from_fn(|_| Vec::with_capacity(count));
    for (b, list) in pixels.iter().enumerate() {
        for &pixel in list {
            let (y, x) = (pixel as usize / size.1, pixel as usize % size.1);
            let (top, bottom, v) = rows[y];
            let (left, right, u) = columns[x];
            let corners = [
                (top, left, (1.0 - v) * (1.0 - u)),
                (top, right, (1.0 - v) * u),
                (bottom, left, v * (1.0 - u)),
                (bottom, right, v * u),
            ];
            for (k, (row, column, weight)) in corners.into_iter().enumerate() {
                indices[k].push(((b * h + row) * w + column) as i32);
                weights[k].push(weight);
            }
        }
    }
    let table = features.reshape([batch * h * w, channels]);
    indices
        .into_iter()
        .zip(weights)
        .map(|(index, weight)| {
            table.clone().select(0, ints(index, &device)) * column(weight, &device)
        })
        .reduce(Tensor::add)
        .unwrap_or_else(|| Tensor::zeros([0, channels], &device))
}

fn ints(values: Vec<i32>, device: &Device) -> Tensor<1, Int> {
    let count = values.len();
    Tensor::from_data(TensorData::new(values, [count]), device)
}

fn column(values: Vec<f32>, device: &Device) -> Tensor<2> {
    let count = values.len();
    Tensor::from_data(TensorData::new(values, [count, 1]), device)
}
