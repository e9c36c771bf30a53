//! What tells a pixel from its neighbours: features at full resolution, from the colours and the
//! extractor's features at a half and a quarter of it. The base functions read them beside the
//! extractor's, which are bilinear between every fourth pixel, and so do the edges.

use super::edges::CHANGES;
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
    /// At a quarter of the resolution.
    pub(super) quarter: Conv,
    /// At a half: what an edge in the colours is, is seen from its surroundings.
    pub(super) context: ConvNorm,
    pub(super) narrow: Conv,
    /// At full resolution.
    pub(super) colour: ConvNorm,
    pub(super) mix: Vec<ConvNorm>,
    pub(super) edges: Conv,
}

impl Detail {
    pub(super) fn init(channels: usize, extractor: &ExtractorConfig, init: &mut Init) -> Self {
        let (same, pointwise) = (ConvSpec::same(1), ConvSpec::pointwise());
        let [first, ..] = extractor.stages;
        Self {
            quarter: Conv::init(extractor.features, first.width, 1, pointwise, init),
            context: ConvNorm::init(first.width, 2 * channels, 3, same, init),
            narrow: Conv::init(2 * channels, channels, 1, pointwise, init),
            colour: ConvNorm::init(3, channels, 3, same, init),
            mix: (0..MIXES)
                .map(|_| ConvNorm::init(channels, channels, 3, same, init))
                .collect(),
            edges: Conv::zero(channels, CHANGES, 1, pointwise, init),
        }
    }

    /// Images, and features at a half and a quarter of their size, to features `[batch, height,
    /// width, channels]` and how edges differ from those of the colours `[batch, height, width,
    /// CHANGES]`.
    pub(super) fn forward(
        &self,
        images: Tensor<4>,
        half: Tensor<4>,
        quarter: Tensor<4>,
    ) -> (Tensor<4>, Tensor<4>) {
        let size = |map: &Tensor<4>| (map.dims()[1], map.dims()[2]);
        let quarter = enlarging(self.quarter.forward(quarter), size(&half));
        let context = self.context.forward_relu(half + quarter);
        let context = enlarging(self.narrow.forward(context), size(&images));
        let gathered = self.colour.forward_relu(images) + context;
        let features = self.mix.iter().fold(gathered, |x, mix| mix.forward_relu(x));
        let edges = self.edges.forward(features.clone());
        (features, edges)
    }
}
