//! The feature extractor of PSMNet (Chang and Chen 2018, `feature_extraction`), a spatial pyramid
//! pooling network that yields features at a quarter of the image's resolution.
//!
//! Two departures, so that every input size works: the pools are 32, 16, 8 and 4 instead of 64,
//! 32, 16 and 8 pixels, and they run in ceil mode, averaging only the pixels inside the map.
//! A third on request: a decoder that sharpens the features at half the resolution.

use super::layers::{Conv, ConvNorm, Init};
use super::resample::{enlarging, pooling};
use crate::conv::ConvSpec;
use crate::error::{Error, Result};
use burn::module::Module;
use burn::tensor::Tensor;
use serde::{Deserialize, Serialize};

/// A run of residual blocks of equal width.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StageConfig {
    /// Channels.
    pub width: usize,
    /// Residual blocks of two 3x3 convolutions.
    pub blocks: usize,
}

/// Widths and depths of the extractor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ExtractorConfig {
    /// Channels of the three convolutions at half resolution.
    pub stem: usize,
    /// Four stages: at half resolution, at a quarter, wider, and with dilation 2.
    pub stages: [StageConfig; 4],
    /// Pool sizes in pixels at a quarter of the resolution, one branch each.
    pub pools: Vec<usize>,
    /// Channels of each pooling branch.
    pub branch: usize,
    /// Channels of the convolution that merges all branches.
    pub merge: usize,
    /// Channels of the result.
    pub features: usize,
    /// Convolutions that sharpen the result at half the image's resolution, with what the first
    /// stage saw there; 0: features stay at a quarter, as PSMNet's.
    pub sharpening: usize,
}

impl Default for ExtractorConfig {
    fn default() -> Self {
        Self::psmnet()
    }
}

impl ExtractorConfig {
    /// PSMNet's sizes: 3,339,552 parameters.
    pub fn psmnet() -> Self {
        let stage = |width, blocks| StageConfig { width, blocks };
        Self {
            stem: 32,
            stages: [stage(32, 3), stage(64, 16), stage(128, 3), stage(128, 3)],
            pools: vec![32, 16, 8, 4],
            branch: 32,
            merge: 128,
            features: 32,
            sharpening: 0,
        }
    }

    /// PSMNet's with 4 instead of 16 blocks in the second stage.
    pub fn medium() -> Self {
        let mut config = Self::psmnet();
        config.stages[1].blocks = 4;
        config
    }

    /// Half the widths and two fifths of the blocks, features twice as wide and sharpened.
    pub fn slim() -> Self {
        let stage = |width, blocks| StageConfig { width, blocks };
        Self {
            stem: 16,
            stages: [stage(16, 2), stage(32, 6), stage(64, 2), stage(64, 1)],
            pools: vec![32, 16, 8, 4],
            branch: 16,
            merge: 64,
            features: 64,
            sharpening: 2,
        }
    }

    /// Half the widths of the slim one.
    pub fn slimmer() -> Self {
        let stage = |width, blocks| StageConfig { width, blocks };
        Self {
            stem: 8,
            stages: [stage(8, 2), stage(16, 6), stage(32, 2), stage(32, 1)],
            branch: 8,
            merge: 32,
            features: 32,
            ..Self::slim()
        }
    }

    pub(super) fn check(&self) -> Result<()> {
        let blocks = self.stages.iter().map(|s| s.blocks);
        if self.widths().contains(&0) || self.pools.contains(&0) || blocks.min() == Some(0) {
            return Err(Error::config(
                "every width, pool and number of blocks of the extractor must be above 0",
            ));
        }
        Ok(())
    }

    /// All widths that a normalisation sees.
    pub(super) fn widths(&self) -> Vec<usize> {
        let mut widths: Vec<usize> = self.stages.iter().map(|s| s.width).collect();
        widths.extend([self.stem, self.branch, self.merge]);
        if self.sharpening > 0 {
            widths.push(self.features);
        }
        widths
    }

    pub(super) fn init(&self, init: &mut Init) -> Extractor {
        let plain = ConvSpec::same(1);
        let [first, second, third, fourth] = self.stages;
        let merged = second.width + fourth.width + self.pools.len() * self.branch;
        Extractor {
            stem: vec![
                ConvNorm::init(3, self.stem, 3, ConvSpec::halving(), init),
                ConvNorm::init(self.stem, self.stem, 3, plain, init),
                ConvNorm::init(self.stem, self.stem, 3, plain, init),
            ],
            half: stage(self.stem, first, plain, plain, init),
            quarter: stage(first.width, second, ConvSpec::halving(), plain, init),
            wide: stage(second.width, third, plain, plain, init),
            dilated: stage(
                third.width,
                fourth,
                ConvSpec::same(2),
                ConvSpec::same(2),
                init,
            ),
            branches: self
                .pools
                .iter()
                .map(|_| ConvNorm::init(fourth.width, self.branch, 1, ConvSpec::pointwise(), init))
                .collect(),
            merge: ConvNorm::init(merged, self.merge, 3, plain, init),
            project: Conv::init(self.merge, self.features, 1, ConvSpec::pointwise(), init),
            sharpen: (self.sharpening > 0).then(|| Sharpen {
                lateral: Conv::init(first.width, self.features, 1, ConvSpec::pointwise(), init),
                mix: (0..self.sharpening)
                    .map(|_| ConvNorm::init(self.features, self.features, 3, plain, init))
                    .collect(),
                last: Conv::zero(self.features, self.features, 1, ConvSpec::pointwise(), init),
            }),
            pools: self.pools.clone(),
        }
    }
}

/// The extractor with its weights.
#[derive(Module, Debug)]
pub struct Extractor {
    pub(super) stem: Vec<ConvNorm>,
    pub(super) half: Vec<Block>,
    pub(super) quarter: Vec<Block>,
    pub(super) wide: Vec<Block>,
    pub(super) dilated: Vec<Block>,
    pub(super) branches: Vec<ConvNorm>,
    pub(super) merge: ConvNorm,
    pub(super) project: Conv,
    pub(super) sharpen: Option<Sharpen>,
    #[module(skip)]
    pub(super) pools: Vec<usize>,
}

/// What is added to the features, enlarged to half the image's resolution: nothing before training.
#[derive(Module, Debug)]
pub(super) struct Sharpen {
    /// From what the first stage saw at that resolution.
    pub(super) lateral: Conv,
    pub(super) mix: Vec<ConvNorm>,
    pub(super) last: Conv,
}

impl Extractor {
    /// `[batch, height, width, 3]` to `[batch, ceil(height / 4), ceil(width / 4), features]`; to
    /// half the resolution if features are sharpened.
    pub fn forward(&self, images: Tensor<4>) -> Tensor<4> {
        let run = |x: Tensor<4>, blocks: &[Block]| blocks.iter().fold(x, |x, b| b.forward(x));
        let x = self
            .stem
            .iter()
            .fold(images, |x, conv| conv.forward_relu(x));
        let half = run(x, &self.half);
        let raw = run(half.clone(), &self.quarter);
        let skip = run(run(raw.clone(), &self.wide), &self.dilated);
        let pooled = self.branches.iter().zip(&self.pools).map(|(conv, &pool)| {
            let [_, height, width, _] = skip.dims();
            let pooled = pooling(skip.clone(), pool);
            enlarging(conv.forward_relu(pooled), (height, width))
        });
        let all = [raw, skip.clone()].into_iter().chain(pooled).collect();
        let merged = self.merge.forward_relu(Tensor::cat(all, 3));
        let features = self.project.forward(merged);
        match &self.sharpen {
            None => features,
            Some(sharpen) => sharpen.forward(features, half),
        }
    }
}

impl Sharpen {
    fn forward(&self, features: Tensor<4>, half: Tensor<4>) -> Tensor<4> {
        let [_, height, width, _] = half.dims();
        let features = enlarging(features, (height, width));
        let x = features.clone() + self.lateral.forward(half);
        let x = self.mix.iter().fold(x, |x, conv| conv.forward_relu(x));
        features + self.last.forward(x)
    }
}

/// PSMNet's residual block: two convolutions, no ReLU after the sum.
#[derive(Module, Debug)]
pub(super) struct Block {
    pub(super) first: ConvNorm,
    pub(super) second: ConvNorm,
    pub(super) shortcut: Option<ConvNorm>,
}

impl Block {
    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let shortcut = match &self.shortcut {
            Some(conv) => conv.forward(x.clone()),
            None => x.clone(),
        };
        self.second.forward(self.first.forward_relu(x)) + shortcut
    }
}

fn stage(
    from: usize,
    config: StageConfig,
    first: ConvSpec,
    others: ConvSpec,
    init: &mut Init,
) -> Vec<Block> {
    (0..config.blocks)
        .map(|i| {
            let (from, spec) = if i == 0 {
                (from, first)
            } else {
                (config.width, others)
            };
            let inner = ConvSpec {
                stride: 1,
                ..others
            };
            let changes = from != config.width || spec.stride != 1;
            let shortcut = ConvSpec {
                stride: spec.stride,
                ..ConvSpec::pointwise()
            };
            Block {
                first: ConvNorm::init(from, config.width, 3, spec, init),
                second: ConvNorm::init(config.width, config.width, 3, inner, init),
                shortcut: changes.then(|| ConvNorm::init(from, config.width, 1, shortcut, init)),
            }
        })
        .collect()
}
