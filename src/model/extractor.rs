//! The feature extractor of PSMNet (Chang and Chen 2018, `feature_extraction`), a spatial pyramid
//! pooling network that yields features at a quarter of the image's resolution.
//!
//! Two departures, so that every input size works: the pools are 32, 16, 8 and 4 instead of 64,
//! 32, 16 and 8 pixels, and they run in ceil mode, averaging only the pixels inside the map.
//! Two more on request: stages at lower resolutions, which add context to the features, and a decoder that sharpens
//! them at half the resolution.

use super::backbone::Backbone;
use super::grid::enlarged;
use super::layers::{Conv, ConvNorm, Init};
use super::pooling::pooling;
use burn::module::Module;
use burn::tensor::Tensor;
use lsdc_core::network::{EncoderConfig, ExtractorConfig, StageConfig};
use lsdc_kernels::conv::ConvSpec;

/// Builds the extractor with its weights.
pub(super) fn build(config: &ExtractorConfig, init: &mut Init) -> Extractor {
    let plain = ConvSpec::same(1);
    let [first, second, third, fourth] = config.stages;
    let merged = second.width + fourth.width + config.pools.len() * config.branch + config.encoder;
    let before = std::iter::once(&fourth).chain(&config.context);
    let context = before.zip(&config.context).map(|(before, &own)| Context {
        blocks: stage(before.width, own, ConvSpec::halving(), plain, init),
        project: Conv::zero(own.width, config.features, 1, ConvSpec::pointwise(), init),
    });
    let context = context.collect();
    let backbone = config.backbone.map(|config| Backbone::init(config, init));
    let reads = backbone.iter().flat_map(Backbone::reads);
    let seen = reads.map(|from| Conv::zero(from, config.features, 1, ConvSpec::pointwise(), init));
    let seen = seen.collect();
    Extractor {
        stem: vec![
            ConvNorm::init(3, config.stem, 3, ConvSpec::halving(), init),
            ConvNorm::init(config.stem, config.stem, 3, plain, init),
            ConvNorm::init(config.stem, config.stem, 3, plain, init),
        ],
        half: stage(config.stem, first, plain, plain, init),
        quarter: stage(first.width, second, ConvSpec::halving(), plain, init),
        wide: stage(second.width, third, plain, plain, init),
        dilated: stage(
            third.width,
            fourth,
            ConvSpec::same(2),
            ConvSpec::same(2),
            init,
        ),
        branches: config
            .pools
            .iter()
            .map(|_| ConvNorm::init(fourth.width, config.branch, 1, ConvSpec::pointwise(), init))
            .collect(),
        encoded: (config.encoder > 0).then(|| Encoded {
            reduce: ConvNorm::init(
                EncoderConfig::small().channels(),
                config.encoder,
                1,
                ConvSpec::pointwise(),
                init,
            ),
            mix: ConvNorm::init(config.encoder, config.encoder, 3, plain, init),
        }),
        merge: ConvNorm::init(merged, config.merge, 3, plain, init),
        project: Conv::init(
            config.merge,
            config.features,
            1,
            ConvSpec::pointwise(),
            init,
        ),
        context,
        backbone,
        seen,
        sharpen: (config.sharpening > 0).then(|| Sharpen {
            lateral: Conv::init(first.width, config.features, 1, ConvSpec::pointwise(), init),
            mix: (0..config.sharpening)
                .map(|_| ConvNorm::init(config.features, config.features, 3, plain, init))
                .collect(),
            last: Conv::zero(
                config.features,
                config.features,
                1,
                ConvSpec::pointwise(),
                init,
            ),
        }),
        pools: config.pools.clone(),
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
    pub(super) encoded: Option<Encoded>,
    pub(super) merge: ConvNorm,
    pub(super) project: Conv,
    pub(super) context: Vec<Context>,
    pub(super) backbone: Option<Backbone>,
    /// What turns what is read of the backbone into features: nothing before training.
    pub(super) seen: Vec<Conv>,
    pub(super) sharpen: Option<Sharpen>,
    #[module(skip)]
    pub(super) pools: Vec<usize>,
}

/// The branch that reads the features of a pretrained encoder, at their resolution.
#[derive(Module, Debug)]
pub(super) struct Encoded {
    pub(super) reduce: ConvNorm,
    pub(super) mix: ConvNorm,
}

/// A stage at a lower resolution, and what it adds to the features: nothing before training.
#[derive(Module, Debug)]
pub(super) struct Context {
    pub(super) blocks: Vec<Block>,
    pub(super) project: Conv,
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
    /// half the resolution if features are sharpened. `encoded [batch, rows, columns, channels]` is what a pretrained
    /// encoder says of the images, for networks trained on one.
    pub fn forward(&self, images: Tensor<4>, encoded: Option<Tensor<4>>) -> Tensor<4> {
        let run = |x: Tensor<4>, blocks: &[Block]| blocks.iter().fold(x, |x, b| b.forward(x));
        let maps = self
            .backbone
            .as_ref()
            .map(|net| net.forward(images.clone()));
        let x = self
            .stem
            .iter()
            .fold(images, |x, conv| conv.forward_relu(x));
        let half = run(x, &self.half);
        let raw = run(half.clone(), &self.quarter);
        let skip = run(run(raw.clone(), &self.wide), &self.dilated);
        let [_, height, width, _] = skip.dims();
        let pooled = self.branches.iter().zip(&self.pools).map(|(conv, &pool)| {
            let pooled = pooling(skip.clone(), pool);
            enlarged(conv.forward_relu(pooled), (height, width))
        });
        let mut all: Vec<Tensor<4>> = [raw, skip.clone()].into_iter().chain(pooled).collect();
        if let (Some(branch), Some(encoded)) = (&self.encoded, encoded) {
            let reduced = branch.reduce.forward_relu(encoded);
            all.push(enlarged(branch.mix.forward_relu(reduced), (height, width)));
        }
        let merged = self.merge.forward_relu(Tensor::cat(all, 3));
        let mut features = self.project.forward(merged);
        let mut x = skip;
        for context in &self.context {
            x = run(x, &context.blocks);
            let seen = context.project.forward(x.clone());
            features = features + enlarged(seen, (height, width));
        }
        for (map, conv) in maps.into_iter().flatten().zip(&self.seen) {
            features = features + enlarged(conv.forward(map), (height, width));
        }
        match &self.sharpen {
            None => features,
            Some(sharpen) => sharpen.forward(features, half),
        }
    }
}

impl Sharpen {
    fn forward(&self, features: Tensor<4>, half: Tensor<4>) -> Tensor<4> {
        let [_, height, width, _] = half.dims();
        let features = enlarged(features, (height, width));
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
