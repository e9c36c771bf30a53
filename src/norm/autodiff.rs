//! The closed-form backward pass on burn's tape.

use super::NormBackend;
use burn::backend::AutodiffBackend as _;
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::autodiff::{Autodiff, NodeId};
use burn::backend::tensor::FloatTensor;

#[derive(Debug)]
struct NormBackward;

#[derive(Clone, Debug)]
struct State<T> {
    x: NodeId,
    gain: NodeId,
    shift: NodeId,
    mean: T,
    variance: T,
    epsilon: f64,
    relu: bool,
}

impl<B: NormBackend> Backward<B, 3> for NormBackward {
    type State = State<FloatTensor<B>>;

    fn backward(
        self,
        ops: Ops<Self::State, 3>,
        grads: &mut Gradients,
        checkpointer: &mut Checkpointer,
    ) {
        let grad = grads.consume::<B>(&ops.node);
        let state = ops.state;
        let mut output = |node| checkpointer.retrieve_node_output::<FloatTensor<B>>(node);
        let (x, gain, shift) = (output(state.x), output(state.gain), output(state.shift));
        let (x, gain, shift) = B::batch_norm_relu_backward(
            x,
            gain,
            shift,
            state.mean,
            state.variance,
            grad,
            state.epsilon,
            state.relu,
        );
        for (node, grad) in ops.parents.into_iter().zip([x, gain, shift]) {
            if let Some(node) = node {
                grads.register::<B>(node.id, grad);
            }
        }
    }
}

impl<B: NormBackend, C: CheckpointStrategy> NormBackend for Autodiff<B, C> {
    fn batch_norm_relu(
        x: FloatTensor<Self>,
        gain: FloatTensor<Self>,
        shift: FloatTensor<Self>,
        epsilon: f64,
        relu: bool,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>) {
        let prepared = NormBackward
            .prepare::<C>([x.node(), gain.node(), shift.node()])
            .compute_bound()
            .stateful();
        let (output, mean, variance) = match prepared {
            OpsKind::Tracked(mut prep) => {
                let nodes = [&x, &gain, &shift].map(|t| prep.checkpoint(t));
                let (output, mean, variance) = B::batch_norm_relu(
                    x.into_primitive(),
                    gain.into_primitive(),
                    shift.into_primitive(),
                    epsilon,
                    relu,
                );
                let state = State {
                    x: nodes[0],
                    gain: nodes[1],
                    shift: nodes[2],
                    mean: mean.clone(),
                    variance: variance.clone(),
                    epsilon,
                    relu,
                };
                (prep.finish(state, output), mean, variance)
            }
            OpsKind::UnTracked(prep) => {
                let (output, mean, variance) = B::batch_norm_relu(
                    x.into_primitive(),
                    gain.into_primitive(),
                    shift.into_primitive(),
                    epsilon,
                    relu,
                );
                (prep.finish(output), mean, variance)
            }
        };
        // Statistics are not differentiated, by contract.
        (output, Self::from_inner(mean), Self::from_inner(variance))
    }
}
