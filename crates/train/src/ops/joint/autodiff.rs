//! The adjoint on burn's tape.

use super::{JointBackend, Problems};
use burn::backend::AutodiffBackend as _;
use burn::backend::autodiff::Autodiff;
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;

#[derive(Debug)]
struct JointBackward;

impl<B: JointBackend> Backward<B, 2> for JointBackward {
    type State = (FloatTensor<B>, Problems);

    fn backward(self, ops: Ops<Self::State, 2>, grads: &mut Gradients, _: &mut Checkpointer) {
        let [bases_node, affinities_node] = ops.parents;
        let grad = grads.consume::<B>(&ops.node);
        let (affinities, problems) = ops.state;
        let (bases, affinities) = B::joint_backward(grad, affinities, problems);
        if let Some(node) = bases_node {
            grads.register::<B>(node.id, bases);
        }
        if let Some(node) = affinities_node {
            grads.register::<B>(node.id, affinities);
        }
    }
}

impl<B: JointBackend, C: CheckpointStrategy> JointBackend for Autodiff<B, C> {
    fn joint(
        bases: FloatTensor<Self>,
        depths: FloatTensor<Self>,
        draws: FloatTensor<Self>,
        affinities: FloatTensor<Self>,
        problems: Problems,
    ) -> FloatTensor<Self> {
        let prepared = JointBackward
            .prepare::<C>([bases.node(), affinities.node()])
            .compute_bound()
            .stateful();
        let (depths, draws) = (depths.into_primitive(), draws.into_primitive());
        let (bases, affinities) = (bases.into_primitive(), affinities.into_primitive());
        let result = B::joint(bases, depths, draws, affinities.clone(), problems.clone());
        match prepared {
            OpsKind::Tracked(prep) => prep.finish((affinities, problems), result),
            OpsKind::UnTracked(prep) => prep.finish(result),
        }
    }

    fn joint_backward(
        grad: FloatTensor<Self>,
        affinities: FloatTensor<Self>,
        problems: Problems,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        let (bases, affinities) =
            B::joint_backward(grad.into_primitive(), affinities.into_primitive(), problems);
        (Self::from_inner(bases), Self::from_inner(affinities))
    }
}
