//! The backward pass: operations of the inner backend.

use super::{ConvNormBackend, ConvNormGradients, ConvNormSpec};
use crate::ops::autodiff::record;
use burn::backend::AutodiffBackend as _;
use burn::backend::autodiff::Autodiff;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;

impl<B: ConvNormGradients, C: CheckpointStrategy> ConvNormBackend for Autodiff<B, C> {
    fn conv_norm(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        gain: FloatTensor<Self>,
        shift: FloatTensor<Self>,
        mean: FloatTensor<Self>,
        variance: FloatTensor<Self>,
        spec: ConvNormSpec,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        let nodes = [x.node(), weight.node(), gain.node(), shift.node()];
        let [x, weight, gain, shift, mean, variance] =
            [x, weight, gain, shift, mean, variance].map(Self::inner);
        let (output, saved) = B::conv_norm(
            x.clone(),
            weight.clone(),
            gain.clone(),
            shift.clone(),
            mean.clone(),
            variance.clone(),
            spec,
        );
        let of_forward = saved.clone();
        let output = record::<B, C, 4>(nodes, output, move |grad, [of_x, ..]| {
            let [on, of_weight, of_gain, of_shift] = B::conv_norm_backward(
                x.clone(),
                weight.clone(),
                gain.clone(),
                shift,
                mean,
                variance.clone(),
                saved,
                grad,
                spec,
            );
            let of_x =
                of_x.then(|| B::conv_norm_backward_input(x, weight, gain, variance, on, spec));
            [of_x, Some(of_weight), Some(of_gain), Some(of_shift)]
        });
        (output, Self::from_inner(of_forward))
    }
}
