//! Features read between pixel centres.

use crate::ops::interpolate::{Cell, interpolate};
use burn::tensor::Tensor;
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
        cell(w, rows[pixel / size.1], columns[pixel % size.1])
    };
    let lists = pixels.iter().map(|list| list.iter().map(cell).collect());
    read(features, lists.collect())
}

/// Reads features `[1, h, w, channels]` at places (u, v) of an image of `size` (height, width):
/// `[places, channels]`.
pub(super) fn sample_places(
    features: Tensor<4>,
    size: (usize, usize),
    places: &[[f64; 2]],
) -> Tensor<2> {
    let [_, h, w, _] = features.dims();
    let cell = |&[u, v]: &[f64; 2]| cell(w, between(v, size.0, h), between(u, size.1, w));
    read(features, vec![places.iter().map(cell).collect()])
}

fn between(place: f64, from: usize, to: usize) -> Between {
    let (low, high, share) = neighbours(place, from, to);
    (low, high, share as f32)
}

/// A cell of a map of features of width `w`.
fn cell(w: usize, (top, bottom, v): Between, (left, right, u): Between) -> Cell {
    let row = |row: usize, column: usize| (row * w + column) as u32;
    Cell {
        rows: [
            row(top, left),
            row(top, right),
            row(bottom, left),
            row(bottom, right),
        ],
        shares: [(1.0 - v) * (1.0 - u), (1.0 - v) * u, v * (1.0 - u), v * u],
    }
}

/// Features `[images, h, w, channels]` at cells of each image.
fn read(features: Tensor<4>, cells: Vec<Vec<Cell>>) -> Tensor<2> {
    let [images, h, w, channels] = features.dims();
    interpolate(features.reshape([images, h * w, channels]), cells)
}
