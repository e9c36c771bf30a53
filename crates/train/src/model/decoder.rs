//! A feature pyramid (Lin et al. 2017) on the outputs of a backbone, on burn's tensors.

use super::backbone::Backbone;
use super::grid::enlarged;
use super::layers::{Conv, ConvNorm, Init};
use burn::module::Module;
use burn::tensor::Tensor;
use lsdc_kernels::conv::ConvSpec;

/// The pyramid, and the layers that read its last level, which are zero before training.
#[derive(Module, Debug)]
pub(super) struct Decoder {
    /// Projections of the outputs of the backbone, the finest first.
    pub(super) lateral: Vec<Conv>,
    pub(super) mix: Vec<ConvNorm>,
    /// Layer added to the features of the extractor.
    pub(super) features: Conv,
    /// Layer that predicts the logarithm of the depth map, if the network has one.
    pub(super) map: Option<Conv>,
}

impl Decoder {
    pub(super) fn init(
        backbone: &Backbone,
        width: usize,
        features: usize,
        mean: bool,
        init: &mut Init,
    ) -> Self {
        let pointwise = ConvSpec::pointwise();
        let reads: Vec<usize> = backbone.reads().collect();
        let mix = reads
            .iter()
            .map(|_| ConvNorm::init(width, width, 3, ConvSpec::same(1), init));
        let mix = mix.collect();
        let lateral = reads
            .iter()
            .map(|&from| Conv::init(from, width, 1, pointwise, init));
        Self {
            mix,
            lateral: lateral.collect(),
            features: Conv::zero(width, features, 1, pointwise, init),
            map: mean.then(|| Conv::zero(width, 1, 1, pointwise, init)),
        }
    }

    /// Computes the last level from the outputs of the backbone `[batch, h, w, channels]`, the finest first, at the resolution
    /// of the finest.
    pub(super) fn forward(&self, maps: Vec<Tensor<4>>) -> Option<Tensor<4>> {
        let levels = maps.into_iter().zip(self.lateral.iter().zip(&self.mix));
        levels.rev().fold(None, |before, (map, (lateral, mix))| {
            let [_, height, width, _] = map.dims();
            let x = lateral.forward(map);
            let x = match before {
                None => x,
                Some(before) => x + enlarged(before, (height, width)),
            };
            Some(mix.forward_relu(x))
        })
    }
}
