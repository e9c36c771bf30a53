//! The closed-form backward pass on burn's tape.

use super::{LstsqBackend, LstsqGradients};
use crate::ops::autodiff::record;
use burn::backend::AutodiffBackend as _;
use burn::backend::autodiff::Autodiff;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;
use lsdc_core::fit::Solver;

impl<B: LstsqGradients, C: CheckpointStrategy> LstsqBackend for Autodiff<B, C> {
    fn lstsq(
        bases: FloatTensor<Self>,
        depths: FloatTensor<Self>,
        weights: FloatTensor<Self>,
        solver: Solver,
    ) -> FloatTensor<Self> {
        let nodes = [bases.node(), depths.node()];
        let [bases, depths, weights] = [bases, depths, weights].map(Self::inner);
        let (solution, factor) =
            B::lstsq_factor(bases.clone(), depths.clone(), weights.clone(), solver);
        record::<B, C, 2>(nodes, solution.clone(), move |grad, _| {
            B::lstsq_backward(bases, depths, weights, solution, factor, grad, solver).map(Some)
        })
    }

    fn lstsq_factor(
        bases: FloatTensor<Self>,
        depths: FloatTensor<Self>,
        weights: FloatTensor<Self>,
        solver: Solver,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        let [bases, depths, weights] = [bases, depths, weights].map(Self::inner);
        let (solution, factor) = B::lstsq_factor(bases, depths, weights, solver);
        (Self::from_inner(solution), Self::from_inner(factor))
    }
}
