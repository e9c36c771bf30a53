//! `EfficientNet`-Lite0 without its classifier (Tan and Le 2019; "Lite": no squeeze and excitation, ReLU), pretrained for image
//! classification.

use super::config::BackboneConfig;
use super::executor::{Executor, Prepare};
use super::tensors::Tensors;
use crate::error::WeightsError;
use lsdc_kernels::conv::ConvSpec;

/// Output channels of the first convolution.
pub const BACKBONE_STEM: usize = 32;

/// Expansion, taps, stride of the first block, channels and number of blocks of each stage.
const STAGES: [[usize; 5]; 7] = [
    [1, 3, 1, 16, 1],
    [6, 3, 2, 24, 2],
    [6, 5, 2, 40, 2],
    [6, 3, 2, 80, 3],
    [6, 5, 1, 112, 3],
    [6, 5, 2, 192, 4],
    [6, 3, 1, 320, 1],
];

/// An inverted residual block (Sandler et al. 2018): an expansion of the channels, a depthwise convolution, and a projection to
/// fewer channels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InvertedBlock {
    /// Channels of the input.
    pub from: usize,
    /// Channels of the depthwise convolution; equal to those of the input if they are not expanded.
    pub inner: usize,
    /// Channels of the output.
    pub to: usize,
    /// Kernel size of the depthwise convolution.
    pub taps: usize,
    /// Stride of the depthwise convolution.
    pub stride: usize,
    /// Whether its output, the last one before the resolution is halved, is an output of the backbone.
    pub read: bool,
}

impl InvertedBlock {
    /// Whether channels are expanded.
    pub fn expands(self) -> bool {
        self.inner != self.from
    }

    /// Whether the input is added to the output.
    pub fn adds(self) -> bool {
        self.stride == 1 && self.from == self.to
    }
}

impl BackboneConfig {
    /// The number of stages.
    pub const MAX_STAGES: usize = STAGES.len();

    /// The blocks of all used stages.
    pub fn blocks(self) -> Vec<InvertedBlock> {
        let mut blocks: Vec<InvertedBlock> = Vec::new();
        let mut from = BACKBONE_STEM;
        let stages = STAGES.iter().take(self.stages);
        for &[expansion, taps, first, to, count] in stages {
            for i in 0..count {
                let stride = if i == 0 { first } else { 1 };
                // Outputs start at a quarter of the image's resolution.
                if let Some(before) = blocks.last_mut() {
                    before.read = stride == 2 && before.from != BACKBONE_STEM;
                }
                blocks.push(InvertedBlock {
                    from,
                    inner: from * expansion,
                    to,
                    taps,
                    stride,
                    read: false,
                });
                from = to;
            }
        }
        if let Some(last) = blocks.last_mut() {
            last.read = true;
        }
        blocks
    }
}

/// The stages with their weights.
#[derive(Debug)]
pub(super) struct Backbone<L> {
    stem: L,
    blocks: Vec<Inverted<L>>,
}

#[derive(Debug)]
struct Inverted<L> {
    config: InvertedBlock,
    expand: Option<L>,
    depthwise: L,
    project: L,
}

impl<L> Backbone<L> {
    pub(super) fn new(
        config: BackboneConfig,
        tensors: &Tensors<'_, impl Prepare<Layer = L>>,
    ) -> Result<Self, WeightsError> {
        let name = |part: &str| format!("extractor.backbone.{part}");
        let pointwise = ConvSpec::pointwise();
        let block = |(i, config): (usize, InvertedBlock)| {
            let name = |part: &str| name(&format!("blocks.{i}.{part}"));
            let InvertedBlock {
                from,
                inner,
                to,
                taps,
                stride,
                ..
            } = config;
            let expand = |()| tensors.conv_norm(&name("expand"), [inner, from, 1], pointwise);
            let spec = ConvSpec::depthwise(taps, stride);
            Ok(Inverted {
                config,
                expand: config.expands().then_some(()).map(expand).transpose()?,
                depthwise: tensors.conv_norm(&name("depthwise"), [inner, 1, taps], spec)?,
                project: tensors.conv_norm(&name("project"), [to, inner, 1], pointwise)?,
            })
        };
        let blocks = config.blocks().into_iter().enumerate();
        Ok(Self {
            blocks: blocks.map(block).collect::<Result<_, _>>()?,
            stem: tensors.conv_norm(&name("stem"), [BACKBONE_STEM, 3, 3], ConvSpec::halving())?,
        })
    }

    /// Returns the outputs of the backbone, finest first.
    pub(super) fn forward<M: Clone>(
        &self,
        image: &M,
        executor: &impl Executor<Layer = L, Map = M>,
    ) -> Vec<M> {
        let mut x = executor.layer(&self.stem, image, None, true);
        let mut maps = Vec::new();
        for block in &self.blocks {
            x = block.forward(&x, executor);
            if block.config.read {
                maps.push(x.clone());
            }
        }
        maps
    }
}

impl<L> Inverted<L> {
    fn forward<M: Clone>(&self, x: &M, executor: &impl Executor<Layer = L, Map = M>) -> M {
        let expanded = self.expand.as_ref();
        let expanded = expanded.map(|layer| executor.layer(layer, x, None, true));
        let expanded = expanded.as_ref().unwrap_or(x);
        let skip = self.config.adds().then_some(x);
        executor.separable(&self.depthwise, &self.project, expanded, skip)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_those_of_efficientnet_lite0() {
        let blocks = BackboneConfig {
            stages: 7,
            ..BackboneConfig::default()
        }
        .blocks();
        assert_eq!(blocks.len(), 16);
        // Weights of convolutions: 4,652,008 parameters, including the classifier and both parameters of every normalisation,
        // as counted by PyTorch for the published file.
        let convolutions = blocks.iter().map(|b| {
            let expand = if b.expands() { b.from * b.inner } else { 0 };
            expand + b.inner * b.taps * b.taps + b.inner * b.to
        });
        let lines = blocks.iter().map(|b| {
            let expand = if b.expands() { b.inner } else { 0 };
            2 * (expand + b.inner + b.to)
        });
        let classifier = 320 * 1280 + 2 * 1280 + 1280 * 1000 + 1000;
        let stem = 27 * BACKBONE_STEM + 2 * BACKBONE_STEM;
        let all = convolutions.chain(lines).sum::<usize>() + stem + classifier;
        assert_eq!(all, 4_652_008);
        let reads = |stages| {
            let config = BackboneConfig {
                stages,
                ..BackboneConfig::default()
            };
            let blocks = config.blocks().into_iter();
            let read = blocks.filter(|b| b.read).map(|b| b.to);
            read.collect::<Vec<usize>>()
        };
        assert_eq!(reads(7), [24, 40, 112, 320]);
        assert_eq!(reads(5), [24, 40, 112]);
        assert_eq!(reads(4), [24, 40, 80]);
        assert_eq!(reads(0), [0; 0]);
    }
}
