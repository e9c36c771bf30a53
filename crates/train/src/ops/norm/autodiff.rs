//! The closed-form backward pass on burn's tape.

use super::{NormBackend, NormGradients, NormSpec};
use crate::ops::autodiff::record;
use burn::backend::AutodiffBackend as _;
use burn::backend::autodiff::Autodiff;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;

impl<B: NormGradients, C: CheckpointStrategy> NormBackend for Autodiff<B, C> {
    fn moments(x: FloatTensor<Self>) -> (FloatTensor<Self>, FloatTensor<Self>) {
        let (mean, variance) = B::moments(Self::inner(x));
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
        let nodes = [x.node(), gain.node(), shift.node()];
        let [x, gain, shift, mean, variance] = [x, gain, shift, mean, variance].map(Self::inner);
        let output = B::normalise(
            x.clone(),
            gain.clone(),
            shift.clone(),
            mean.clone(),
            variance.clone(),
            spec,
        );
        record::<B, C, 3>(nodes, output, move |grad, _| {
            B::normalise_backward(x, gain, shift, mean, variance, grad, spec).map(Some)
        })
    }
}
