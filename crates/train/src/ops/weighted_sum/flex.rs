//! The operation on flex, with all threads for large tensors.

use super::{WeightedSumBackend, reference};
use burn::backend::tensor::FloatTensor;
use burn::backend::{DType, Flex, TensorMetadata as _};
use burn::tensor::TensorData;
use burn_flex::FlexTensor;
use rayon::prelude::*;

/// Number of values from which on a thread is worth waking.
const PIECE: usize = 1 << 15;

impl WeightedSumBackend for Flex {
    fn weighted_sum(
        x: FloatTensor<Self>,
        a: f32,
        y: FloatTensor<Self>,
        b: f32,
    ) -> FloatTensor<Self> {
        if x.dtype() != DType::F32 {
            return reference::<Self>(x, a, y, b);
        }
        let (x, y) = (x.to_contiguous(), y.to_contiguous());
        let pieces = x
            .storage::<f32>()
            .par_iter()
            .with_min_len(PIECE)
            .zip(y.storage::<f32>());
        let sums: Vec<f32> = pieces.map(|(x, y)| a * x + b * y).collect();
        FlexTensor::from_data(TensorData::new(sums, x.shape().to_vec()))
    }
}
