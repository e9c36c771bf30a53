//! Convolutional spatial propagation (Cheng et al. 2018, `CSPN`): a residual network with a decoder and skip connections
//! predicts a depth, and the weights of the neighbours of each pixel in a propagation step.

use super::layers::{UpConv, UpConvNorm};
use super::resnet::{ResNet, ResNetDepth, check_width};
use super::s2d::UpProj;
use super::{System, SystemInput, SystemOutput};
use burn::module::Module;
use burn::tensor::Tensor;
use burn::tensor::activation::relu;
use lsdc_files::error::{Error, Result};
use lsdc_train::model::layers::{ConvNorm, Init};
use lsdc_train::ops::conv::ConvSpec;
use lsdc_train::ops::propagate::{NEIGHBOURS, OFFSETS, propagate};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Sizes of the network; the defaults are those of the published one. 218.122 M of its 256.078 M parameters are implemented
/// here: the others belong to layers that the authors' program creates but never runs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CspnConfig {
    /// The encoder.
    pub encoder: ResNetDepth,
    /// Number of channels of the first layer; all others are multiples of it.
    pub width: usize,
    /// Number of propagation steps.
    pub steps: usize,
    /// File of `torchvision` weights to initialise the encoder; random if absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pretrained: Option<PathBuf>,
}

impl Default for CspnConfig {
    fn default() -> Self {
        Self {
            encoder: ResNetDepth::default(),
            width: 64,
            steps: 24,
            pretrained: None,
        }
    }
}

impl CspnConfig {
    pub(super) fn check(&self) -> Result<()> {
        if self.steps > 1000 {
            return Err(Error::config("`system.steps` must be at most 1000"));
        }
        check_width(self.width)
    }

    /// Returns the number of parameters that the authors' program counts but never uses: four up-projections and a convolution.
    pub(super) fn never_run(&self) -> usize {
        let [.., third, _] = self.encoder.channels(self.width);
        let steps = (0..4).map(|step| {
            let (from, to) = (third >> step, third >> (step + 1));
            2 * 25 * from * to + 9 * to * to + 6 * to
        });
        steps.sum::<usize>() + 9 * 2 * self.width
    }
}

/// The network with its weights.
#[derive(Module, Debug)]
pub struct Cspn {
    pub(super) resnet: ResNet,
    middle: ConvNorm,
    first: UpProj,
    joined: Vec<SkipUpProj>,
    depth: UpConv,
    affinity: UpConv,
    #[module(skip)]
    steps: usize,
}

/// Up-projection with a skip connection from the encoder level of its output size.
#[derive(Module, Debug)]
struct SkipUpProj {
    first: UpConvNorm,
    join: ConvNorm,
    second: ConvNorm,
    shortcut: UpConvNorm,
}

impl SkipUpProj {
    fn init(from: usize, to: usize, side: usize, init: &mut Init) -> Self {
        let same = ConvSpec::same(1);
        Self {
            first: UpConvNorm::init(from, to, 5, to, init),
            join: ConvNorm::init(to + side, to, 3, same, init),
            second: ConvNorm::init(to, to, 3, same, init),
            shortcut: UpConvNorm::init(from, to, 5, to, init),
        }
    }

    fn forward(&self, x: Tensor<4>, side: Tensor<4>) -> Tensor<4> {
        let [_, height, width, _] = side.dims();
        let size = (height, width);
        let branch = Tensor::cat(vec![self.first.forward(x.clone(), size, true), side], 3);
        let branch = self.second.forward(self.join.forward_relu(branch));
        relu(branch + self.shortcut.forward(x, size, false))
    }
}

impl Cspn {
    pub(super) fn init(config: &CspnConfig, init: &mut Init) -> Self {
        let width = config.width;
        let resnet = ResNet::init(config.encoder, 4, width, init);
        let [first, second, third, deepest] = config.encoder.channels(width);
        let joined = [
            (third, second, second),
            (second, first, first),
            (first, width, width),
        ];
        Self {
            resnet,
            middle: ConvNorm::init(deepest, deepest, 3, ConvSpec::same(1), init),
            first: UpProj::init(deepest, third, init),
            joined: joined
                .map(|(from, to, side)| SkipUpProj::init(from, to, side, init))
                .into(),
            depth: UpConv::init(width, 1, 3, 1, init),
            affinity: UpConv::init(width, NEIGHBOURS, 3, NEIGHBOURS, init),
            steps: config.steps,
        }
    }
}

impl System for Cspn {
    fn predict(&self, input: &SystemInput) -> SystemOutput {
        let [_, height, width, _] = input.images.dims();
        let levels = self.resnet.forward(input.rgbd());
        let [first, second, third, deepest] = levels.stages;
        let size = |map: &Tensor<4>| (map.dims()[1], map.dims()[2]);
        let x = self.middle.forward(deepest);
        let x = self.first.forward(x, size(&third));
        let sides = [second, first, levels.stem];
        let pairs = self.joined.iter().zip(sides);
        let x = pairs.fold(x, |x, (step, side)| step.forward(x, side));
        let affinity = self.affinity.forward(x.clone(), (height, width));
        let depth = self.depth.forward(x, (height, width)).squeeze_dim(3);
        let depth = propagate(shares(affinity), depth, input.sparse.clone(), self.steps);
        SystemOutput::single(depth)
    }
}

/// Returns the weights of the neighbours of each pixel, from the outputs of the network: `[n, height, width, 8]` both. The
/// absolute values of a pixel sum to 1; all are 0 if all outputs are 0.
fn shares(affinity: Tensor<4>) -> Tensor<4> {
    /// Lower bound of the sum, far below every affinity.
    const LEAST: f64 = 1e-12;
    let [n, height, width, _] = affinity.dims();
    let padded = affinity.pad([(1, 1), (1, 1), (0, 0)], 0.0);
    let of = |(k, (rows, columns)): (usize, (isize, isize))| {
        let first = |offset: isize| (1 + offset) as usize;
        let (top, left) = (first(rows), first(columns));
        padded
            .clone()
            .slice([0..n, top..top + height, left..left + width, k..k + 1])
    };
    let gates = Tensor::cat(OFFSETS.into_iter().enumerate().map(of).collect(), 3);
    let sum = gates.clone().abs().sum_dim(3).clamp_min(LEAST);
    gates / sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::{Device, TensorData};

    #[test]
    fn shares_are_those_of_the_neighbours() {
        let values: Vec<f32> = (0..2 * 2 * NEIGHBOURS).map(|i| 1.0 + i as f32).collect();
        let affinity = TensorData::new(values, [1, 2, 2, NEIGHBOURS]);
        let shares = shares(Tensor::from_data(affinity, &Device::flex()));
        let shares: Vec<f32> = shares.into_data().iter().collect();
        // The first pixel has three neighbours: right, below, and below right.
        let (right, below, beyond) = (9.0 + 3.0, 17.0 + 1.0, 25.0);
        let sum = right + below + beyond;
        let expected = [
            beyond / sum,
            below / sum,
            0.0,
            right / sum,
            0.0,
            0.0,
            0.0,
            0.0,
        ];
        for (found, expected) in shares.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-6, "{shares:?}");
        }
    }

    #[test]
    fn the_published_count_has_layers_that_never_run() {
        let never = CspnConfig::default().never_run();
        assert!((37_900_000..38_000_000).contains(&never), "{never}");
    }
}
