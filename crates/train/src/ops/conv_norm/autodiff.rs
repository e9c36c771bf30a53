//! The backward pass: ops of the inner backend.

use super::{ConvNormBackend, ConvNormSpec};
use burn::backend::AutodiffBackend as _;
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::autodiff::{Autodiff, NodeId};
use burn::backend::tensor::FloatTensor;

#[derive(Debug)]
struct ConvNormBackward;

#[derive(Clone, Debug)]
struct State<B: ConvNormBackend> {
    /// Of input, weight, gain and shift.
    nodes: [NodeId; 4],
    mean: FloatTensor<B>,
    variance: FloatTensor<B>,
    kept: FloatTensor<B>,
    spec: ConvNormSpec,
}

impl<B: ConvNormBackend> Backward<B, 4> for ConvNormBackward {
    type State = State<B>;

    fn backward(
        self,
        ops: Ops<Self::State, 4>,
        grads: &mut Gradients,
        checkpointer: &mut Checkpointer,
    ) {
        let grad = grads.consume::<B>(&ops.node);
        let State {
            nodes,
            mean,
            variance,
            kept,
            spec,
        } = ops.state;
        let [x, weight, gain, shift] =
            nodes.map(|node| checkpointer.retrieve_node_output::<FloatTensor<B>>(node));
        let (on, weight_grad, gain_grad, shift_grad) = B::conv_norm_backward(
            x.clone(),
            weight.clone(),
            gain.clone(),
            shift,
            mean,
            variance.clone(),
            kept,
            grad,
            spec,
        );
        let [x_node, parameters @ ..] = ops.parents;
        for (node, grad) in parameters
            .into_iter()
            .zip([weight_grad, gain_grad, shift_grad])
        {
            if let Some(node) = node {
                grads.register::<B>(node.id, grad);
            }
        }
        if let Some(node) = x_node {
            let grad = B::conv_norm_backward_input(x, weight, gain, variance, on, spec);
            grads.register::<B>(node.id, grad);
        }
    }
}

impl<B: ConvNormBackend, C: CheckpointStrategy> ConvNormBackend for Autodiff<B, C> {
    fn conv_norm(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        gain: FloatTensor<Self>,
        shift: FloatTensor<Self>,
        mean: FloatTensor<Self>,
        variance: FloatTensor<Self>,
        spec: ConvNormSpec,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        let (mean, variance) = (mean.into_primitive(), variance.into_primitive());
        let prepared = ConvNormBackward
            .prepare::<C>([x.node(), weight.node(), gain.node(), shift.node()])
            .compute_bound()
            .stateful();
        let forward = |x: FloatTensor<Self>, weight: FloatTensor<Self>| {
            B::conv_norm(
                x.into_primitive(),
                weight.into_primitive(),
                gain.clone().into_primitive(),
                shift.clone().into_primitive(),
                mean.clone(),
                variance.clone(),
                spec,
            )
        };
        let (output, kept) = match prepared {
            OpsKind::Tracked(mut prep) => {
                let nodes = [&x, &weight, &gain, &shift].map(|t| prep.checkpoint(t));
                let (output, kept) = forward(x, weight);
                let state = State {
                    nodes,
                    mean,
                    variance,
                    kept: kept.clone(),
                    spec,
                };
                (prep.finish(state, output), kept)
            }
            OpsKind::UnTracked(prep) => {
                let (output, kept) = forward(x, weight);
                (prep.finish(output), kept)
            }
        };
        (output, Self::from_inner(kept))
    }

    fn conv_norm_backward(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        gain: FloatTensor<Self>,
        shift: FloatTensor<Self>,
        mean: FloatTensor<Self>,
        variance: FloatTensor<Self>,
        kept: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        spec: ConvNormSpec,
    ) -> (
        FloatTensor<Self>,
        FloatTensor<Self>,
        FloatTensor<Self>,
        FloatTensor<Self>,
    ) {
        let (on, weight, gain, shift) = B::conv_norm_backward(
            x.into_primitive(),
            weight.into_primitive(),
            gain.into_primitive(),
            shift.into_primitive(),
            mean.into_primitive(),
            variance.into_primitive(),
            kept.into_primitive(),
            grad.into_primitive(),
            spec,
        );
        (
            Self::from_inner(on),
            Self::from_inner(weight),
            Self::from_inner(gain),
            Self::from_inner(shift),
        )
    }

    fn conv_norm_backward_input(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        gain: FloatTensor<Self>,
        variance: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        spec: ConvNormSpec,
    ) -> FloatTensor<Self> {
        Self::from_inner(B::conv_norm_backward_input(
            x.into_primitive(),
            weight.into_primitive(),
            gain.into_primitive(),
            variance.into_primitive(),
            grad.into_primitive(),
            spec,
        ))
    }
}
