//! The closed-form backward pass on burn's tape.

use super::{PropagateBackend, PropagateGradients};
use crate::ops::autodiff::record;
use burn::backend::AutodiffBackend as _;
use burn::backend::autodiff::Autodiff;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;

impl<B: PropagateGradients, C: CheckpointStrategy> PropagateBackend for Autodiff<B, C> {
    fn spread(
        weights: FloatTensor<Self>,
        start: FloatTensor<Self>,
        known: FloatTensor<Self>,
        steps: usize,
    ) -> FloatTensor<Self> {
        let nodes = [weights.node(), start.node()];
        let [weights, start, known] = [weights, start, known].map(Self::inner);
        let output = B::spread(weights.clone(), start.clone(), known.clone(), steps);
        record::<B, C, 2>(nodes, output, move |grad, _| {
            B::spread_backward(weights, start, known, grad, steps).map(Some)
        })
    }
}
