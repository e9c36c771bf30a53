//! Average pooling over windows of a map.

use burn::tensor::{Device, Tensor, TensorData};

/// Averages `[batch, height, width, channels]` over windows of `pool` x `pool` pixels, truncated at the end: `[batch,
/// ceil(height / pool), ceil(width / pool), channels]`.
pub(super) fn pooling(map: Tensor<4>, pool: usize) -> Tensor<4> {
    let [batch, height, width, channels] = map.dims();
    let [new_height, new_width] = [height, width].map(|length| length.div_ceil(pool));
    let device = map.device();
    // First along columns, then along rows.
    let map = map.reshape([batch, height, width * channels]);
    let map = matrix(height, pool, &device).matmul(map);
    let map = map.reshape([batch * new_height, width, channels]);
    let map = matrix(width, pool, &device).matmul(map);
    map.reshape([batch, new_height, new_width, channels])
}

/// Returns `averages` as a tensor that broadcasts over batches.
fn matrix(length: usize, pool: usize, device: &Device) -> Tensor<3> {
    let values = TensorData::new(averages(length, pool), [1, length.div_ceil(pool), length]);
    Tensor::from_data(values, device)
}

/// Returns the matrix `[ceil(length / pool), length]` of averages over windows truncated at the end.
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
}
