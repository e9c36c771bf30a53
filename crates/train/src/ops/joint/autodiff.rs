//! The adjoint on burn's tape.

use super::{JointBackend, JointGradients, Problems};
use crate::ops::autodiff::record;
use burn::backend::AutodiffBackend as _;
use burn::backend::autodiff::Autodiff;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;

impl<B: JointGradients, C: CheckpointStrategy> JointBackend for Autodiff<B, C> {
    fn joint(
        bases: FloatTensor<Self>,
        depths: FloatTensor<Self>,
        draws: FloatTensor<Self>,
        affinities: FloatTensor<Self>,
        problems: Problems,
    ) -> FloatTensor<Self> {
        let nodes = [bases.node(), affinities.node()];
        let [bases, depths, draws, affinities] =
            [bases, depths, draws, affinities].map(Self::inner);
        let result = B::joint(bases, depths, draws, affinities.clone(), problems.clone());
        record::<B, C, 2>(nodes, result, move |grad, _| {
            B::joint_backward(grad, affinities, problems).map(Some)
        })
    }
}
