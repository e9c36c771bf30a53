//! The closed-form backward pass on burn's tape.

use super::PropagateBackend;
use burn::backend::AutodiffBackend as _;
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::autodiff::{Autodiff, NodeId};
use burn::backend::tensor::FloatTensor;

#[derive(Debug)]
struct SpreadBackward;

impl<B: PropagateBackend> Backward<B, 2> for SpreadBackward {
    /// Nodes of weights and start; what is known; the number of steps.
    type State = ([NodeId; 2], FloatTensor<B>, usize);

    fn backward(
        self,
        ops: Ops<Self::State, 2>,
        grads: &mut Gradients,
        checkpointer: &mut Checkpointer,
    ) {
        let grad = grads.consume::<B>(&ops.node);
        let (nodes, known, steps) = ops.state;
        let [weights, start] =
            nodes.map(|node| checkpointer.retrieve_node_output::<FloatTensor<B>>(node));
        let (weights, start) = B::spread_backward(weights, start, known, grad, steps);
        for (node, grad) in ops.parents.into_iter().zip([weights, start]) {
            if let Some(node) = node {
                grads.register::<B>(node.id, grad);
            }
        }
    }
}

impl<B: PropagateBackend, C: CheckpointStrategy> PropagateBackend for Autodiff<B, C> {
    fn spread(
        weights: FloatTensor<Self>,
        start: FloatTensor<Self>,
        known: FloatTensor<Self>,
        steps: usize,
    ) -> FloatTensor<Self> {
        let known = known.into_primitive();
        let prepared = SpreadBackward
            .prepare::<C>([weights.node(), start.node()])
            .compute_bound()
            .stateful();
        match prepared {
            OpsKind::Tracked(mut prep) => {
                let nodes = [&weights, &start].map(|tensor| prep.checkpoint(tensor));
                let (weights, start) = (weights.into_primitive(), start.into_primitive());
                let output = B::spread(weights, start, known.clone(), steps);
                prep.finish((nodes, known, steps), output)
            }
            OpsKind::UnTracked(prep) => prep.finish(B::spread(
                weights.into_primitive(),
                start.into_primitive(),
                known,
                steps,
            )),
        }
    }

    fn spread_backward(
        weights: FloatTensor<Self>,
        start: FloatTensor<Self>,
        known: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        steps: usize,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        let (weights, start) = B::spread_backward(
            weights.into_primitive(),
            start.into_primitive(),
            known.into_primitive(),
            grad.into_primitive(),
            steps,
        );
        (Self::from_inner(weights), Self::from_inner(start))
    }
}
