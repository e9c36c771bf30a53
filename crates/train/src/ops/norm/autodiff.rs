//! The closed-form backward pass on burn's tape.

use super::{NormBackend, NormSpec};
use burn::backend::AutodiffBackend as _;
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::autodiff::{Autodiff, NodeId};
use burn::backend::tensor::FloatTensor;

#[derive(Debug)]
struct NormBackward;

impl<B: NormBackend> Backward<B, 3> for NormBackward {
    /// Nodes of input, gain and shift; mean and variance; what was done.
    type State = ([NodeId; 3], FloatTensor<B>, FloatTensor<B>, NormSpec);

    fn backward(
        self,
        ops: Ops<Self::State, 3>,
        grads: &mut Gradients,
        checkpointer: &mut Checkpointer,
    ) {
        let grad = grads.consume::<B>(&ops.node);
        let (nodes, mean, variance, spec) = ops.state;
        let [x, gain, shift] =
            nodes.map(|node| checkpointer.retrieve_node_output::<FloatTensor<B>>(node));
        let (x, gain, shift) = B::normalise_backward(x, gain, shift, mean, variance, grad, spec);
        for (node, grad) in ops.parents.into_iter().zip([x, gain, shift]) {
            if let Some(node) = node {
                grads.register::<B>(node.id, grad);
            }
        }
    }
}

impl<B: NormBackend, C: CheckpointStrategy> NormBackend for Autodiff<B, C> {
    fn moments(x: FloatTensor<Self>) -> (FloatTensor<Self>, FloatTensor<Self>) {
        let (mean, variance) = B::moments(x.into_primitive());
        (Self::from_inner(mean), Self::from_inner(variance))
    }

    fn normalise(
        x: FloatTensor<Self>,
        gain: FloatTensor<Self>,
        shift: FloatTensor<Self>,
        mean: FloatTensor<Self>,
        variance: FloatTensor<Self>,
        spec: NormSpec,
    ) -> FloatTensor<Self> {
        let (mean, variance) = (mean.into_primitive(), variance.into_primitive());
        let prepared = NormBackward
            .prepare::<C>([x.node(), gain.node(), shift.node()])
            .compute_bound()
            .stateful();
        match prepared {
            OpsKind::Tracked(mut prep) => {
                let nodes = [&x, &gain, &shift].map(|t| prep.checkpoint(t));
                let output = B::normalise(
                    x.into_primitive(),
                    gain.into_primitive(),
                    shift.into_primitive(),
                    mean.clone(),
                    variance.clone(),
                    spec,
                );
                prep.finish((nodes, mean, variance, spec), output)
            }
            OpsKind::UnTracked(prep) => prep.finish(B::normalise(
                x.into_primitive(),
                gain.into_primitive(),
                shift.into_primitive(),
                mean,
                variance,
                spec,
            )),
        }
    }

    fn normalise_backward(
        x: FloatTensor<Self>,
        gain: FloatTensor<Self>,
        shift: FloatTensor<Self>,
        mean: FloatTensor<Self>,
        variance: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        spec: NormSpec,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>) {
        let (x, gain, shift) = B::normalise_backward(
            x.into_primitive(),
            gain.into_primitive(),
            shift.into_primitive(),
            mean.into_primitive(),
            variance.into_primitive(),
            grad.into_primitive(),
            spec,
        );
        (
            Self::from_inner(x),
            Self::from_inner(gain),
            Self::from_inner(shift),
        )
    }
}
