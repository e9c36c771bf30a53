//! Features read between pixel centres.

use burn::tensor::{Device, Int, Tensor, TensorData};
use lsdc_core::bilinear::neighbours;

/// Where a place lies along an axis of the features: two neighbours, and the weight of the second.
type Between = (usize, usize, f32);

/// Reads features `[batch, h, w, channels]` at pixels of an image of `size` (height, width).
///
/// `pixels[b]` lists `y * width + x`, equally many for each image; the result is
/// `[batch * pixels, channels]`.
pub(super) fn sample(features: Tensor<4>, size: (usize, usize), pixels: &[Vec<u32>]) -> Tensor<2> {
    let [_, h, w, _] = features.dims();
    let axis = |from: usize, to: usize| (0..from).map(|i| between(i as f64, from, to)).collect();
    let (rows, columns): (Vec<_>, Vec<_>) = (axis(size.0, h), axis(size.1, w));
    let cell = |&pixel: &u32| {
        let pixel = pixel as usize;
        (rows[pixel / size.1], columns[pixel % size.1])
    };
    let lists = pixels.iter().map(|list| list.iter().map(cell).collect());
    blend(features, &lists.collect::<Vec<_>>())
}

/// Reads features `[1, h, w, channels]` at places (u, v) of an image of `size` (height, width):
/// `[places, channels]`.
pub(super) fn sample_places(
    features: Tensor<4>,
    size: (usize, usize),
    places: &[[f64; 2]],
) -> Tensor<2> {
    let [_, h, w, _] = features.dims();
    let cell = |&[u, v]: &[f64; 2]| (between(v, size.0, h), between(u, size.1, w));
    blend(features, &[places.iter().map(cell).collect()])
}

fn between(place: f64, from: usize, to: usize) -> Between {
    let (low, high, share) = neighbours(place, from, to);
    (low, high, share as f32)
}

/// Weighted sums of four features for each row and column.
fn blend(features: Tensor<4>, cells: &[Vec<(Between, Between)>]) -> Tensor<2> {
    let [batch, h, w, channels] = features.dims();
    let device = features.device();
    let count: usize = cells.iter().map(Vec::len).sum();
    let mut indices: [Vec<i32>; 4] = std::array::from_fn(|_| Vec::with_capacity(count));
    let mut weights: [Vec<f32>; 4] = std::array::from_fn(|_| Vec::with_capacity(count));
    for (b, list) in cells.iter().enumerate() {
        for &((top, bottom, v), (left, right, u)) in list {
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
