//! The backward pass: two operations of the inner backend.

use super::{ConvBackend, ConvGradients, ConvSpec};
use crate::ops::autodiff::record;
use burn::backend::AutodiffBackend as _;
use burn::backend::autodiff::Autodiff;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;

impl<B: ConvGradients, C: CheckpointStrategy> ConvBackend for Autodiff<B, C> {
    fn conv(x: FloatTensor<Self>, weight: FloatTensor<Self>, spec: ConvSpec) -> FloatTensor<Self> {
        let nodes = [x.node(), weight.node()];
        let [x, weight] = [x, weight].map(Self::inner);
        let output = B::conv(x.clone(), weight.clone(), spec);
        record::<B, C, 2>(nodes, output, move |grad, [of_x, of_weight]| {
            let of_x =
                of_x.then(|| B::conv_backward_input(x.clone(), weight.clone(), grad.clone(), spec));
            let of_weight = of_weight.then(|| B::conv_backward_weight(x, weight, grad, spec));
            [of_x, of_weight]
        })
    }
}
