//! The operation on flex with all threads: forward in chunks of cells, backward image by image.

use super::{BatchCells, InterpolateBackend, InterpolateGradients, reference, reference_backward};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Flex, TensorMetadata as _};
use burn::tensor::{DType, TensorData};
use burn_flex::FlexTensor;
use lsdc_kernels::gather::{gather, scatter};
use rayon::prelude::*;

impl InterpolateBackend for Flex {
    fn read_between(table: FloatTensor<Self>, cells: BatchCells) -> FloatTensor<Self> {
        if table.dtype() != DType::F32 {
            return reference::<Self>(table, &cells);
        }
        let table = table.to_contiguous();
        let channels = table.shape()[2];
        let output = gather(table.storage(), channels, &cells);
        let rows = output.len() / channels.max(1);
        FlexTensor::from_data(TensorData::new(output, [rows, channels]))
    }
}

impl InterpolateGradients for Flex {
    fn read_between_backward(
        grad: FloatTensor<Self>,
        [images, rows, channels]: [usize; 3],
        cells: BatchCells,
    ) -> FloatTensor<Self> {
        if grad.dtype() != DType::F32 {
            return reference_backward::<Self>(grad, [images, rows, channels], &cells);
        }
        let grad = grad.to_contiguous();
        let mut shares = Vec::with_capacity(images);
        let mut remaining: &[f32] = grad.storage();
        for cells in cells.iter() {
            let (share, other) = remaining.split_at(cells.len() * channels);
            shares.push((share, cells));
            remaining = other;
        }
        let mut table = vec![0.0_f32; images * rows * channels];
        table
            .par_chunks_mut((rows * channels).max(1))
            .zip(shares)
            .for_each(|(table, (grad, cells))| scatter(grad, channels, cells, table));
        FlexTensor::from_data(TensorData::new(table, [images, rows, channels]))
    }
}
