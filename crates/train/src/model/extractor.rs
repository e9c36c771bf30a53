//! The feature extractor of PSMNet (Chang and Chen 2018, `feature_extraction`), a spatial pyramid
//! pooling network that yields features at a quarter of the image's resolution.
//!
//! Two changes make every input size work: the pools are 32, 16, 8 and 4 instead of 64, 32, 16 and 8 pixels, and they run in
//! ceil mode, averaging only the pixels inside the map. Optional parts: stages at lower resolutions and a pretrained backbone,
//! which add context to the features, and layers that sharpen them at half the resolution.

use super::backbone::Backbone;
use super::decoder::Decoder;
use super::grid::enlarged;
use super::layers::{Conv, ConvNorm, Init};
use super::pooling::pooling;
use burn::module::Module;
use burn::tensor::Tensor;
use lsdc_core::network::{EncoderConfig, ExtractorConfig, StageConfig};
use lsdc_kernels::conv::ConvSpec;

/// Builds the extractor with its weights; `mean` is whether the network predicts a depth map.
pub(super) fn build(config: &ExtractorConfig, mean: bool, init: &mut Init) -> Extractor {
    let plain = ConvSpec::same(1);
    let [first, second, third, fourth] = config.stages;
    let merged = second.width + fourth.width + config.pools.len() * config.branch + config.encoder;
    let before = std::iter::once(&fourth).chain(&config.context);
    let context = before
        .zip(&config.context)
        .map(|(before, &own)| ContextStage {
            blocks: stage(before.width, own, ConvSpec::halving(), plain, init),
            project: Conv::zero(own.width, config.features, 1, ConvSpec::pointwise(), init),
        });
    let context = context.collect();
    let backbone = config.backbone.map(|own| Backbone::init(own, init));
    let decoder = config.backbone.zip(backbone.as_ref());
    let decoder =
        decoder.map(|(own, net)| Decoder::init(net, own.decoder, config.features, mean, init));
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
        encoded: (config.encoder > 0).then(|| EncoderBranch {
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
        decoder,
        sharpen: (config.sharpening > 0).then(|| Sharpening {
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
    pub(super) half: Vec<ResidualBlock>,
    pub(super) quarter: Vec<ResidualBlock>,
    pub(super) wide: Vec<ResidualBlock>,
    pub(super) dilated: Vec<ResidualBlock>,
    pub(super) branches: Vec<ConvNorm>,
    pub(super) encoded: Option<EncoderBranch>,
    pub(super) merge: ConvNorm,
    pub(super) project: Conv,
    pub(super) context: Vec<ContextStage>,
    pub(super) backbone: Option<Backbone>,
    pub(super) decoder: Option<Decoder>,
    pub(super) sharpen: Option<Sharpening>,
    #[module(skip)]
    pub(super) pools: Vec<usize>,
}

/// The branch for the features of a pretrained encoder, at their resolution.
#[derive(Module, Debug)]
pub(super) struct EncoderBranch {
    pub(super) reduce: ConvNorm,
    pub(super) mix: ConvNorm,
}

/// A stage at a lower resolution, and its projection added to the features; zero before training.
#[derive(Module, Debug)]
pub(super) struct ContextStage {
    pub(super) blocks: Vec<ResidualBlock>,
    pub(super) project: Conv,
}

/// Layers added to the features, upsampled to half the image's resolution; zero before training.
#[derive(Module, Debug)]
pub(super) struct Sharpening {
    /// Projection of the output of the first stage at that resolution.
    pub(super) lateral: Conv,
    pub(super) mix: Vec<ConvNorm>,
    pub(super) last: Conv,
}

/// The output of an extractor.
#[derive(Clone, Debug)]
pub struct ExtractorOutput {
    /// `[batch, h, w, channels]`
    pub features: Tensor<4>,
    /// Logarithm of the depth map predicted by a backbone, `[batch, h, w, 1]`, at the same resolution.
    pub logarithm: Option<Tensor<4>>,
}

impl Extractor {
    /// Returns the last level of the backbone's pyramid.
    fn decoded(&self, images: Tensor<4>) -> Option<Tensor<4>> {
        let (backbone, decoder) = (self.backbone.as_ref()?, self.decoder.as_ref()?);
        decoder.forward(backbone.forward(images))
    }

    /// Returns only the logarithm of the depth map predicted by the backbone, as in [`ExtractorOutput`].
    pub(super) fn logarithm(&self, images: Tensor<4>) -> Option<Tensor<4>> {
        let [_, height, width, _] = images.dims();
        let layer = self.decoder.as_ref()?.map.as_ref()?;
        let map = layer.forward(self.decoded(images)?);
        Some(match self.sharpen {
            None => map,
            Some(_) => enlarged(map, (height.div_ceil(2), width.div_ceil(2))),
        })
    }

    /// Computes features `[batch, ceil(height / 4), ceil(width / 4), channels]`, or at half the resolution if they are
    /// sharpened, from images `[batch, height, width, 3]`. `encoded [batch, rows, columns, channels]` are features of a
    /// pretrained encoder, for networks trained on one.
    pub fn forward(&self, images: Tensor<4>, encoded: Option<Tensor<4>>) -> ExtractorOutput {
        let run =
            |x: Tensor<4>, blocks: &[ResidualBlock]| blocks.iter().fold(x, |x, b| b.forward(x));
        let decoded = self.decoded(images.clone());
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
            let change = context.project.forward(x.clone());
            features = features + enlarged(change, (height, width));
        }
        let mut logarithm = None;
        if let (Some(decoder), Some(decoded)) = (&self.decoder, decoded) {
            let change = decoder.features.forward(decoded.clone());
            features = features + enlarged(change, (height, width));
            let map = decoder.map.as_ref();
            logarithm = map.map(|layer| layer.forward(decoded));
        }
        let features = match &self.sharpen {
            None => features,
            Some(sharpen) => sharpen.forward(features, half),
        };
        let [_, height, width, _] = features.dims();
        ExtractorOutput {
            logarithm: logarithm.map(|map| enlarged(map, (height, width))),
            features,
        }
    }
}

impl Sharpening {
    fn forward(&self, features: Tensor<4>, half: Tensor<4>) -> Tensor<4> {
        let [_, height, width, _] = half.dims();
        let features = enlarged(features, (height, width));
        let x = features.clone() + self.lateral.forward(half);
        let x = self.mix.iter().fold(x, |x, conv| conv.forward_relu(x));
        features + self.last.forward(x)
    }
}

/// PSMNet's residual block: two convolutions, without ReLU after the sum.
#[derive(Module, Debug)]
pub(super) struct ResidualBlock {
    pub(super) first: ConvNorm,
    pub(super) second: ConvNorm,
    pub(super) shortcut: Option<ConvNorm>,
}

impl ResidualBlock {
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
) -> Vec<ResidualBlock> {
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
            ResidualBlock {
                first: ConvNorm::init(from, config.width, 3, spec, init),
                second: ConvNorm::init(config.width, config.width, 3, inner, init),
                shortcut: changes.then(|| ConvNorm::init(from, config.width, 1, shortcut, init)),
            }
        })
        .collect()
}
