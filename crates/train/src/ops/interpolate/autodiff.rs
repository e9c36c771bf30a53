//! The backward pass: one operation of the inner backend.

use super::{BatchCells, InterpolateBackend, InterpolateGradients, PixelReads};
use crate::ops::autodiff::record;
use burn::backend::autodiff::Autodiff;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;
use burn::backend::{AutodiffBackend as _, TensorMetadata as _};
use std::sync::Arc;

impl<B: InterpolateGradients, C: CheckpointStrategy> InterpolateBackend for Autodiff<B, C> {
    fn read_between(table: FloatTensor<Self>, cells: BatchCells) -> FloatTensor<Self> {
        let shape = table.shape().dims();
        let nodes = [table.node()];
        let output = B::read_between(Self::inner(table), cells.clone());
        record::<B, C, 1>(nodes, output, move |grad, [of_table]| {
            [of_table.then(|| B::read_between_backward(grad, shape, cells))]
        })
    }

    fn read_pixels(table: FloatTensor<Self>, reads: Arc<PixelReads>) -> FloatTensor<Self> {
        let shape = table.shape().dims();
        let nodes = [table.node()];
        let output = B::read_pixels(Self::inner(table), reads.clone());
        record::<B, C, 1>(nodes, output, move |grad, [of_table]| {
            [of_table.then(|| B::read_pixels_backward(grad, shape, reads))]
        })
    }
}
