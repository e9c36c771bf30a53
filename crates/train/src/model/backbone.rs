//! Stages of a pretrained `EfficientNet`-Lite0, on burn's tensors.

use super::layers::{ConvNorm, Init};
use burn::module::Module;
use burn::tensor::Tensor;
use lsdc_core::network::{BACKBONE_STEM, BackboneConfig, InvertedBlock};
use lsdc_kernels::conv::ConvSpec;

/// A backbone with its weights.
#[derive(Module, Debug)]
pub(super) struct Backbone {
    pub(super) stem: ConvNorm,
    pub(super) blocks: Vec<InvertedResidual>,
}

/// An inverted residual block.
#[derive(Module, Debug)]
pub(super) struct InvertedResidual {
    pub(super) expand: Option<ConvNorm>,
    pub(super) depthwise: ConvNorm,
    pub(super) project: ConvNorm,
    #[module(skip)]
    pub(super) config: InvertedBlock,
}

impl Backbone {
    pub(super) fn init(config: BackboneConfig, init: &mut Init) -> Self {
        let pointwise = ConvSpec::pointwise();
        let mut block = |config: InvertedBlock| {
            let InvertedBlock {
                from,
                inner,
                to,
                taps,
                stride,
                ..
            } = config;
            let spec = ConvSpec::depthwise(taps, stride);
            let expands = config.expands();
            InvertedResidual {
                expand: expands.then(|| ConvNorm::init(from, inner, 1, pointwise, init)),
                depthwise: ConvNorm::init(1, inner, taps, spec, init),
                project: ConvNorm::init(inner, to, 1, pointwise, init),
                config,
            }
        };
        let blocks = config.blocks().into_iter().map(&mut block).collect();
        Self {
            stem: ConvNorm::init(3, BACKBONE_STEM, 3, ConvSpec::halving(), init),
            blocks,
        }
    }

    /// Returns the channels of the maps returned by `forward`.
    pub(super) fn reads(&self) -> impl Iterator<Item = usize> {
        let read = self.blocks.iter().filter(|block| block.config.read);
        read.map(|block| block.config.to)
    }

    /// Computes the outputs `[batch, h, w, channels]` of the last block at each resolution, from a quarter of the resolution of
    /// the images `[batch, height, width, 3]` down.
    pub(super) fn forward(&self, images: Tensor<4>) -> Vec<Tensor<4>> {
        let mut x = self.stem.forward_relu(images);
        let mut maps = Vec::new();
        for block in &self.blocks {
            x = block.forward(x);
            if block.config.read {
                maps.push(x.clone());
            }
        }
        maps
    }
}

impl InvertedResidual {
    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let inner = match &self.expand {
            None => x.clone(),
            Some(expand) => expand.forward_relu(x.clone()),
        };
        let y = self.project.forward(self.depthwise.forward_relu(inner));
        if self.config.adds() { y + x } else { y }
    }
}
