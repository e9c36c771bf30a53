//! The residual network (He et al. 2016) as in `torchvision`, without its classifier: from colours and depth to features at up
//! to a thirty-second of the resolution.

use super::layers::largest;
use burn::module::Module;
use burn::tensor::Tensor;
use burn::tensor::activation::relu;
use lsdc_files::error::{Error, Result};
use lsdc_train::model::layers::{Conv, ConvNorm, Init, Norm};
use lsdc_train::ops::conv::ConvSpec;
use serde::{Deserialize, Serialize};

/// Depth of a network, in layers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ResNetDepth {
    /// 18 layers: 2 blocks of two convolutions in each stage.
    ResNet18,
    /// 50 layers: 3, 4, 6 and 3 blocks of three convolutions.
    #[default]
    ResNet50,
}

impl ResNetDepth {
    /// Returns its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::ResNet18 => "resnet18",
            Self::ResNet50 => "resnet50",
        }
    }

    fn blocks(self) -> [usize; 4] {
        match self {
            Self::ResNet18 => [2, 2, 2, 2],
            Self::ResNet50 => [3, 4, 6, 3],
        }
    }

    /// Returns the ratio of the output channels of a stage to the channels of its blocks.
    fn expansion(self) -> usize {
        match self {
            Self::ResNet18 => 1,
            Self::ResNet50 => 4,
        }
    }

    /// Returns the output channels of each stage, for a first layer of `width` channels.
    pub(super) fn channels(self, width: usize) -> [usize; 4] {
        [1, 2, 4, 8].map(|times| times * width * self.expansion())
    }
}

/// Checks the number of channels of the first layer; 64 in the published networks.
pub(super) fn check_width(width: usize) -> Result<()> {
    if width.is_multiple_of(2) && (2..=256).contains(&width) {
        return Ok(());
    }
    Err(Error::config(
        "`system.width` must be even, from 2 to 256 (64 as published)",
    ))
}

/// The network with its weights.
#[derive(Module, Debug)]
pub(super) struct ResNet {
    stem: Stem,
    layer1: Vec<Block>,
    layer2: Vec<Block>,
    layer3: Vec<Block>,
    layer4: Vec<Block>,
}

#[derive(Module, Debug)]
struct Stem {
    conv: Conv,
    norm: Norm,
}

/// A residual block of two or three convolutions.
#[derive(Module, Debug)]
struct Block {
    convs: Vec<ConvNorm>,
    shortcut: Option<ConvNorm>,
}

/// Outputs of a network at each level of resolution.
pub(super) struct Levels {
    /// Output of the first convolution alone, at half the resolution.
    pub(super) stem: Tensor<4>,
    /// Outputs of the stages, at a quarter, an eighth, a sixteenth and a thirty-second of the resolution.
    pub(super) stages: [Tensor<4>; 4],
}

impl ResNet {
    pub(super) fn init(depth: ResNetDepth, inputs: usize, width: usize, init: &mut Init) -> Self {
        let spec = ConvSpec {
            stride: 2,
            padding: 3,
            ..ConvSpec::pointwise()
        };
        let stem = Stem {
            conv: Conv::init(inputs, width, 7, spec, init),
            norm: Norm::init(width, init),
        };
        let channels = depth.channels(width);
        let mut from = width;
        let mut stages =
            channels
                .iter()
                .zip(depth.blocks())
                .enumerate()
                .map(|(stage, (&to, count))| {
                    let blocks = (0..count).map(|i| {
                        let stride = if stage > 0 && i == 0 { 2 } else { 1 };
                        let block = Block::init(depth, from, to, stride, init);
                        from = to;
                        block
                    });
                    blocks.collect::<Vec<_>>()
                });
        let mut next = || stages.next().unwrap_or_default();
        Self {
            stem,
            layer1: next(),
            layer2: next(),
            layer3: next(),
            layer4: next(),
        }
    }

    /// Computes features from `[n, height, width, inputs]`.
    pub(super) fn forward(&self, x: Tensor<4>) -> Levels {
        let stem = self.stem.conv.forward(x);
        let x = self.stem.norm.forward(stem.clone(), true);
        let mut x = largest(x, 3, 2, 1);
        let layers = [&self.layer1, &self.layer2, &self.layer3, &self.layer4];
        let stages = layers.map(|blocks| {
            x = blocks.iter().fold(x.clone(), |x, block| block.forward(x));
            x.clone()
        });
        Levels { stem, stages }
    }
}

impl Block {
    fn init(depth: ResNetDepth, from: usize, to: usize, stride: usize, init: &mut Init) -> Self {
        let inner = to / depth.expansion();
        let strided = ConvSpec {
            stride,
            ..ConvSpec::same(1)
        };
        let (same, pointwise) = (ConvSpec::same(1), ConvSpec::pointwise());
        let convs = match depth {
            ResNetDepth::ResNet18 => vec![
                ConvNorm::init(from, to, 3, strided, init),
                ConvNorm::init(to, to, 3, same, init),
            ],
            ResNetDepth::ResNet50 => vec![
                ConvNorm::init(from, inner, 1, pointwise, init),
                ConvNorm::init(inner, inner, 3, strided, init),
                ConvNorm::init(inner, to, 1, pointwise, init),
            ],
        };
        let changes = stride != 1 || from != to;
        let spec = ConvSpec {
            stride,
            ..pointwise
        };
        Self {
            convs,
            shortcut: changes.then(|| ConvNorm::init(from, to, 1, spec, init)),
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let shortcut = match &self.shortcut {
            Some(conv) => conv.forward(x.clone()),
            None => x.clone(),
        };
        let last = self.convs.len() - 1;
        let convs = self.convs.iter().enumerate();
        let x = convs.fold(x, |x, (i, conv)| {
            if i == last {
                conv.forward(x)
            } else {
                conv.forward_relu(x)
            }
        });
        relu(x + shortcut)
    }
}

/// Returns the `torchvision` name of a tensor of this network; `None` for other names.
pub(super) fn torchvision(name: &str) -> Option<String> {
    let (place, last) = if let Some(place) = name.strip_suffix(".conv.weight") {
        (place, ("conv", "weight"))
    } else {
        let (place, kind) = name.split_once(".norm.Batch.")?;
        let kind = match kind {
            "gain" => "weight",
            "shift" => "bias",
            "running_mean" => "running_mean",
            "running_variance" => "running_var",
            _ => return None,
        };
        (place, ("bn", kind))
    };
    let (part, kind) = last;
    if place == "stem" {
        return Some(format!("{part}1.{kind}"));
    }
    if let Some(block) = place.strip_suffix(".shortcut") {
        let part = usize::from(part != "conv");
        return Some(format!("{block}.downsample.{part}.{kind}"));
    }
    let (block, number) = place.split_once(".convs.")?;
    let number: usize = number.parse().ok()?;
    Some(format!("{block}.{part}{}.{kind}", number + 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tensors_have_the_names_of_torchvision() {
        for (ours, theirs) in [
            ("stem.conv.weight", "conv1.weight"),
            ("stem.norm.Batch.shift", "bn1.bias"),
            ("layer2.3.convs.1.conv.weight", "layer2.3.conv2.weight"),
            (
                "layer4.0.convs.2.norm.Batch.running_variance",
                "layer4.0.bn3.running_var",
            ),
            (
                "layer1.0.shortcut.conv.weight",
                "layer1.0.downsample.0.weight",
            ),
            (
                "layer1.0.shortcut.norm.Batch.gain",
                "layer1.0.downsample.1.weight",
            ),
        ] {
            assert_eq!(torchvision(ours).as_deref(), Some(theirs));
        }
        assert_eq!(torchvision("layer1.0.convs.0.norm.Group.gain"), None);
        assert_eq!(torchvision("last.weight"), None);
    }
}
