//! What tells a pixel from its neighbours: features at full resolution, from the colours and the
//! extractor's features at a half and a quarter of it. The base functions read them beside the
//! extractor's, which are bilinear between every fourth pixel, and so do the edges.

use super::extractor::ExtractorConfig;
use super::layers::{Conv, ConvNorm, Init};
use super::resample::enlarging;
use crate::conv::ConvSpec;
use burn::module::Module;
use burn::tensor::Tensor;

/// Convolutions at full resolution after the colours'.
const MIXES: usize = 2;

/// The network's part at full resolution.
#[derive(Module, Debug)]
pub(super) struct Detail {
    pub(super) colour: ConvNorm,
    pub(super) half: Conv,
    pub(super) quarter: Conv,
    pub(super) mix: Vec<ConvNorm>,
    pub(super) edges: Conv,
}

impl Detail {
    pub(super) fn init(channels: usize, extractor: &ExtractorConfig, init: &mut Init) -> Self {
        let (same, pointwise) = (ConvSpec::same(1), ConvSpec::pointwise());
        let [first, ..] = extractor.stages;
        Self {
            colour: ConvNorm::init(3, channels, 3, same, init),
            half: Conv::init(first.width, channels, 1, pointwise, init),
            quarter: Conv::init(extractor.features, channels, 1, pointwise, init),
            mix: (0..MIXES)
                .map(|_| ConvNorm::init(channels, channels, 3, same, init))
                .collect(),
            edges: Conv::zero(channels, 2, 1, pointwise, init),
        }
    }

    /// Images, and features at a half and a quarter of their size, to features `[batch, height,
    /// width, channels]`, and the logarithm `[batch, height, width, 2]` by which each pixel is
    /// joined more strongly to its right and lower neighbour than its colour says.
    pub(super) fn forward(
        &self,
        images: Tensor<4>,
        half: Tensor<4>,
        quarter: Tensor<4>,
    ) -> (Tensor<4>, Tensor<4>) {
        let [_, height, width, _] = images.dims();
        let size = (height, width);
        let half = enlarging(self.half.forward(half), size);
        let quarter = enlarging(self.quarter.forward(quarter), size);
        let colour = self.colour.forward_relu(images);
        let gathered = colour + half + quarter;
        let features = self.mix.iter().fold(gathered, |x, mix| mix.forward_relu(x));
        let edges = self.edges.forward(features.clone());
        (features, edges)
    }
}
