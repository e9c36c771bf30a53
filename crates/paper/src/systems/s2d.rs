//! Sparse-to-dense (Ma and Karaman 2018): a residual network that reads colours and sparse depths, followed by four steps that
//! double the resolution. As in the authors' `sparse-to-dense.pytorch`.

use super::layers::{UpConvNorm, stretched};
use super::resnet::{ResNet, ResNetDepth, check_width};
use super::{System, SystemInput, SystemOutput};
use burn::module::Module;
use burn::tensor::Tensor;
use burn::tensor::activation::relu;
use lsdc_files::error::Result;
use lsdc_train::model::layers::{Conv, ConvNorm, Init};
use lsdc_train::ops::conv::ConvSpec;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Kind of decoder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DecoderKind {
    /// The up-projections of Laina et al. 2016.
    #[default]
    UpProj,
    /// Transposed convolutions with three taps.
    DeConv3,
}

/// Sizes of the network; the defaults are those of the published one with 63.566 M parameters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct S2dConfig {
    /// The encoder.
    pub encoder: ResNetDepth,
    /// The decoder.
    pub decoder: DecoderKind,
    /// Number of channels of the first layer; all others are multiples of it.
    pub width: usize,
    /// File of `torchvision` weights to initialise the encoder; random if absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pretrained: Option<PathBuf>,
}

impl Default for S2dConfig {
    fn default() -> Self {
        Self {
            encoder: ResNetDepth::default(),
            decoder: DecoderKind::default(),
            width: 64,
            pretrained: None,
        }
    }
}

impl S2dConfig {
    pub(super) fn check(&self) -> Result<()> {
        check_width(self.width)
    }
}

/// The network with its weights.
#[derive(Module, Debug)]
pub struct S2d {
    pub(super) resnet: ResNet,
    squeeze: ConvNorm,
    decoder: Decoder,
    last: Conv,
}

#[derive(Module, Debug)]
enum Decoder {
    UpProj(Vec<UpProj>),
    DeConv(Vec<UpConvNorm>),
}

/// Up-projection: the sum of two branches that double the size.
#[derive(Module, Debug)]
pub(super) struct UpProj {
    first: UpConvNorm,
    second: ConvNorm,
    shortcut: UpConvNorm,
}

impl UpProj {
    pub(super) fn init(from: usize, to: usize, init: &mut Init) -> Self {
        Self {
            first: UpConvNorm::init(from, to, 5, to, init),
            second: ConvNorm::init(to, to, 3, ConvSpec::same(1), init),
            shortcut: UpConvNorm::init(from, to, 5, to, init),
        }
    }

    pub(super) fn forward(&self, x: Tensor<4>, size: (usize, usize)) -> Tensor<4> {
        let branch = self
            .second
            .forward(self.first.forward(x.clone(), size, true));
        relu(branch + self.shortcut.forward(x, size, false))
    }
}

impl S2d {
    pub(super) fn init(config: &S2dConfig, init: &mut Init) -> Self {
        let pointwise = ConvSpec::pointwise();
        let resnet = ResNet::init(config.encoder, 4, config.width, init);
        let [.., deepest] = config.encoder.channels(config.width);
        let widths = [1, 2, 4, 8, 16].map(|part| deepest / 2 / part);
        let pairs = widths.windows(2).map(|pair| (pair[0], pair[1]));
        let squeeze = ConvNorm::init(deepest, widths[0], 1, pointwise, init);
        let decoder = match config.decoder {
            DecoderKind::UpProj => Decoder::UpProj(
                pairs
                    .map(|(from, to)| UpProj::init(from, to, init))
                    .collect(),
            ),
            DecoderKind::DeConv3 => Decoder::DeConv(
                pairs
                    .map(|(from, to)| UpConvNorm::init(from, to, 3, from, init))
                    .collect(),
            ),
        };
        Self {
            resnet,
            squeeze,
            decoder,
            last: Conv::init(widths[4], 1, 3, ConvSpec::same(1), init),
        }
    }
}

impl System for S2d {
    fn predict(&self, input: &SystemInput) -> SystemOutput {
        let [_, height, width, _] = input.images.dims();
        let [.., deepest] = self.resnet.forward(input.rgbd()).stages;
        let x = self.squeeze.forward(deepest);
        let twice = |x: &Tensor<4>| (2 * x.dims()[1], 2 * x.dims()[2]);
        let x = match &self.decoder {
            Decoder::UpProj(steps) => steps.iter().fold(x, |x, step| {
                let size = twice(&x);
                step.forward(x, size)
            }),
            Decoder::DeConv(steps) => steps.iter().fold(x, |x, step| {
                let size = twice(&x);
                step.forward(x, size, true)
            }),
        };
        let depth = stretched(self.last.forward(x), (height, width));
        SystemOutput::single(depth.squeeze_dim(3))
    }
}
