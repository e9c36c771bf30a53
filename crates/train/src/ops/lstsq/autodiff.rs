//! The closed-form backward pass on burn's tape.

use super::LstsqBackend;
use burn::backend::AutodiffBackend as _;
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::autodiff::{Autodiff, NodeId};
use burn::backend::tensor::FloatTensor;
use lsdc_core::fit::Solver;

#[derive(Debug)]
struct LstsqBackward;

impl<B: LstsqBackend> Backward<B, 2> for LstsqBackward {
    /// Bases and depths, weights, solution, factor.
    type State = (NodeId, NodeId, [FloatTensor<B>; 3], Solver);

    fn backward(
        self,
        ops: Ops<Self::State, 2>,
        grads: &mut Gradients,
        checkpointer: &mut Checkpointer,
    ) {
        let [bases_node, depths_node] = ops.parents;
        let grad = grads.consume::<B>(&ops.node);
        let (bases, depths, [weights, solution, factor], solver) = ops.state;
        let bases: FloatTensor<B> = checkpointer.retrieve_node_output(bases);
        let depths: FloatTensor<B> = checkpointer.retrieve_node_output(depths);
        let (bases, depths) =
            B::lstsq_backward(bases, depths, weights, solution, factor, grad, solver);
        if let Some(node) = bases_node {
            grads.register::<B>(node.id, bases);
        }
        if let Some(node) = depths_node {
            grads.register::<B>(node.id, depths);
        }
    }
}

impl<B: LstsqBackend, C: CheckpointStrategy> LstsqBackend for Autodiff<B, C> {
    fn lstsq(
        bases: FloatTensor<Self>,
        depths: FloatTensor<Self>,
        weights: FloatTensor<Self>,
        solver: Solver,
    ) -> FloatTensor<Self> {
        let weights = weights.into_primitive();
        let prepared = LstsqBackward
            .prepare::<C>([bases.node(), depths.node()])
            .compute_bound()
            .stateful();
        match prepared {
            OpsKind::Tracked(mut prep) => {
                let (f, d) = (prep.checkpoint(&bases), prep.checkpoint(&depths));
                let (bases, depths) = (bases.into_primitive(), depths.into_primitive());
                let (solution, factor) = B::lstsq_factor(bases, depths, weights.clone(), solver);
                let state = [weights, solution.clone(), factor];
                prep.finish((f, d, state, solver), solution)
            }
            OpsKind::UnTracked(prep) => prep.finish(B::lstsq(
                bases.into_primitive(),
                depths.into_primitive(),
                weights,
                solver,
            )),
        }
    }

    fn lstsq_factor(
        bases: FloatTensor<Self>,
        depths: FloatTensor<Self>,
        weights: FloatTensor<Self>,
        solver: Solver,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        let (solution, factor) = B::lstsq_factor(
            bases.into_primitive(),
            depths.into_primitive(),
            weights.into_primitive(),
            solver,
        );
        (Self::from_inner(solution), Self::from_inner(factor))
    }

    fn lstsq_backward(
        bases: FloatTensor<Self>,
        depths: FloatTensor<Self>,
        weights: FloatTensor<Self>,
        solution: FloatTensor<Self>,
        factor: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        solver: Solver,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        let (bases, depths) = B::lstsq_backward(
            bases.into_primitive(),
            depths.into_primitive(),
            weights.into_primitive(),
            solution.into_primitive(),
            factor.into_primitive(),
            grad.into_primitive(),
            solver,
        );
        (Self::from_inner(bases), Self::from_inner(depths))
    }
}
