//! Pooling and enlargement of whole maps `[batch, height, width, channels]`.

use burn::tensor::{Device, Tensor, TensorData};
use lsdc_core::bilinear::neighbours;

/// A linear map along rows and one along columns: pooling or bilinear enlargement of a whole map.
struct Separable {
    /// `[height', height]`
    rows: Tensor<2>,
    /// `[width', width]`
    columns: Tensor<2>,
}

impl Separable {
    /// `[batch, height, width, channels]` to `[batch, height', width', channels]`.
    fn apply(&self, x: Tensor<4>) -> Tensor<4> {
        let [batch, height, width, channels] = x.dims();
        let [new_height, new_width] = [self.rows.dims()[0], self.columns.dims()[0]];
        let x = x.reshape([batch, height, width * channels]);
        let x = self.rows.clone().unsqueeze::<3>().matmul(x);
        let x = x.reshape([batch * new_height, width, channels]);
        let x = self.columns.clone().unsqueeze::<3>().matmul(x);
        x.reshape([batch, new_height, new_width, channels])
    }
}

/// Averages over windows of `pool` pixels, cut off at the end.
pub(super) fn pooling(map: Tensor<4>, pool: usize) -> Tensor<4> {
    let [_, height, width, _] = map.dims();
    let matrix = |length: usize| {
        let values = averages(length, pool);
        tensor(values, length.div_ceil(pool), length, &map.device())
    };
    let (rows, columns) = (matrix(height), matrix(width));
    Separable { rows, columns }.apply(map)
}

/// Bilinear enlargement to a height and width.
pub(super) fn enlarging(map: Tensor<4>, size: (usize, usize)) -> Tensor<4> {
    let [_, height, width, _] = map.dims();
    let matrix = |from: usize, to: usize| tensor(enlargement(from, to), to, from, &map.device());
    let (rows, columns) = (matrix(height, size.0), matrix(width, size.1));
    Separable { rows, columns }.apply(map)
}

fn tensor(values: Vec<f32>, rows: usize, columns: usize, device: &Device) -> Tensor<2> {
    Tensor::from_data(TensorData::new(values, [rows, columns]), device)
}

/// Matrix `[ceil(length / pool), length]` of averages over windows cut off at the end.
fn averages(length: usize, pool: usize) -> Vec<f32> {
    let windows = length.div_ceil(pool);
    let mut matrix = vec![0.0; windows * length];
    for i in 0..length {
        let window = i / pool;
        let count = pool.min(length - window * pool);
        matrix[window * length + i] = 1.0 / count as f32;
    }
    matrix
}

/// Matrix `[to, from]` of bilinear interpolation between pixel centres.
fn enlargement(from: usize, to: usize) -> Vec<f32> {
    let mut matrix = vec![0.0; to * from];
    for i in 0..to {
        let (low, high, t) = neighbours(i as f64, to, from);
        let t = t as f32;
        matrix[i * from + low] += 1.0 - t;
        matrix[i * from + high] += t;
    }
    matrix
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pools_count_only_pixels_inside() {
        assert_eq!(
            averages(5, 2),
            [
                0.5, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0
            ]
        );
    }

    #[test]
    fn enlargement_is_exact_on_ramps_inside() {
        let matrix = enlargement(4, 8);
        let row = |i: usize| (0..4).map(|j| matrix[i * 4 + j] * j as f32).sum::<f32>();
        for i in 1..7 {
            assert!((row(i) - (f32::midpoint(i as f32, 0.5) - 0.5)).abs() < 1e-6);
        }
        assert!(row(0).abs() < 1e-6 && (row(7) - 3.0).abs() < 1e-6);
    }
}
