//! The feature extractor, layer by layer.

use super::backbone::Backbone;
use super::config::{ExtractorConfig, StageConfig};
use super::decoder::Decoder;
use super::executor::{Executor, Prepare};
use super::tensors::Tensors;
use crate::error::WeightsError;
use lsdc_kernels::conv::ConvSpec;

#[derive(Debug)]
pub(super) struct Extractor<L> {
    stem: Vec<L>,
    half: Vec<Block<L>>,
    quarter: Vec<Block<L>>,
    /// The wider stage, followed by the dilated one.
    skip: Vec<Block<L>>,
    /// The pool size of each branch.
    pools: Vec<usize>,
    /// The convolution of each branch.
    branches: Vec<L>,
    /// Convolutions of the encoder's features, at their resolution.
    encoded: Vec<L>,
    merge: L,
    project: L,
    /// Blocks at successively lower resolutions, each with the projection to an addend for the features.
    context: Vec<(Vec<Block<L>>, L)>,
    backbone: Option<(Backbone<L>, Decoder<L>)>,
    sharpen: Option<Sharpen<L>>,
}

/// The output of an extractor.
#[derive(Clone, Debug)]
pub struct ExtractedMaps<M> {
    /// At a quarter of the image's resolution, or at half of it if features are sharpened.
    pub features: M,
    /// Logarithm of the map of depth predicted by a backbone, at the same resolution.
    pub logarithm: Option<M>,
}

#[derive(Debug)]
struct Sharpen<L> {
    lateral: L,
    mix: Vec<L>,
    last: L,
}

#[derive(Debug)]
struct Block<L> {
    first: L,
    second: L,
    shortcut: Option<L>,
}

impl<L> Block<L> {
    /// A sequence of blocks; the first one changes width and resolution.
    fn stage(
        tensors: &Tensors<'_, impl Prepare<Layer = L>>,
        name: &str,
        from: usize,
        config: StageConfig,
        first: ConvSpec,
        others: ConvSpec,
    ) -> Result<Vec<Self>, WeightsError> {
        let width = config.width;
        let block = |i: usize| {
            let name = |part: &str| format!("extractor.{name}.{i}.{part}");
            let (from, spec) = if i == 0 {
                (from, first)
            } else {
                (width, others)
            };
            let inner = ConvSpec {
                stride: 1,
                ..others
            };
            let across = ConvSpec {
                stride: spec.stride,
                ..ConvSpec::pointwise()
            };
            let changes = from != width || spec.stride != 1;
            let shortcut =
                changes.then(|| tensors.conv_norm(&name("shortcut"), [width, from, 1], across));
            Ok(Self {
                first: tensors.conv_norm(&name("first"), [width, from, 3], spec)?,
                second: tensors.conv_norm(&name("second"), [width, width, 3], inner)?,
                shortcut: shortcut.transpose()?,
            })
        };
        (0..config.blocks).map(block).collect()
    }

    fn forward<M: Clone>(&self, x: M, executor: &impl Executor<Layer = L, Map = M>) -> M {
        let inner = executor.layer(&self.first, &x, None, true);
        let shortcut = match &self.shortcut {
            None => x,
            Some(layer) => {
                let shortcut = executor.layer(layer, &x, None, false);
                drop(x);
                shortcut
            }
        };
        executor.layer(&self.second, &inner, Some(&shortcut), false)
    }
}

impl<L> Extractor<L> {
    /// `channels` is the number of channels of the encoder's features, if there is an encoder; `mean` is whether the network
    /// predicts a map of depth.
    pub(super) fn new(
        config: &ExtractorConfig,
        channels: Option<usize>,
        mean: bool,
        tensors: &Tensors<'_, impl Prepare<Layer = L>>,
    ) -> Result<Self, WeightsError> {
        let (plain, pointwise) = (ConvSpec::same(1), ConvSpec::pointwise());
        let (halving, dilated) = (ConvSpec::halving(), ConvSpec::same(2));
        let [first, second, third, fourth] = config.stages;
        let stem = |i: usize| {
            let name = format!("extractor.stem.{i}");
            let (from, spec) = match i {
                0 => (3, halving),
                _ => (config.stem, plain),
            };
            tensors.conv_norm(&name, [config.stem, from, 3], spec)
        };
        let mut skip = Block::stage(tensors, "wide", second.width, third, plain, plain)?;
        skip.extend(Block::stage(
            tensors,
            "dilated",
            third.width,
            fourth,
            dilated,
            dilated,
        )?);
        let branch = |i: usize| {
            let name = format!("extractor.branches.{i}");
            tensors.conv_norm(&name, [config.branch, fourth.width, 1], pointwise)
        };
        let branches = (0..config.pools.len()).map(branch);
        let encoded = |channels: usize| {
            let name = |part: &str| format!("extractor.encoded.{part}");
            let width = config.encoder;
            Ok::<_, WeightsError>(vec![
                tensors.conv_norm(&name("reduce"), [width, channels, 1], pointwise)?,
                tensors.conv_norm(&name("mix"), [width, width, 3], plain)?,
            ])
        };
        let merged =
            second.width + fourth.width + config.pools.len() * config.branch + config.encoder;
        let project = [config.features, config.merge, 1];
        let before = std::iter::once(&fourth).chain(&config.context);
        let context = before.zip(&config.context).enumerate();
        let context = context.map(|(i, (before, &own))| {
            let blocks = format!("context.{i}.blocks");
            let project = format!("extractor.context.{i}.project");
            let sizes = [config.features, own.width, 1];
            Ok((
                Block::stage(tensors, &blocks, before.width, own, halving, plain)?,
                tensors.conv(&project, sizes, pointwise)?,
            ))
        });
        Ok(Self {
            stem: (0..3).map(stem).collect::<Result<_, _>>()?,
            half: Block::stage(tensors, "half", config.stem, first, plain, plain)?,
            quarter: Block::stage(tensors, "quarter", first.width, second, halving, plain)?,
            skip,
            pools: config.pools.clone(),
            branches: branches.collect::<Result<_, _>>()?,
            encoded: channels.map(encoded).transpose()?.unwrap_or_default(),
            merge: tensors.conv_norm("extractor.merge", [config.merge, merged, 3], plain)?,
            project: tensors.conv("extractor.project", project, pointwise)?,
            context: context.collect::<Result<_, WeightsError>>()?,
            backbone: config
                .backbone
                .map(|backbone| {
                    let decoder = Decoder::new(backbone, config.features, mean, tensors)?;
                    Ok((Backbone::new(backbone, tensors)?, decoder))
                })
                .transpose()?,
            sharpen: match config.sharpening {
                0 => None,
                layers => Some(Sharpen::new(tensors, first.width, config.features, layers)?),
            },
        })
    }

    pub(super) fn forward<M: Clone>(
        &self,
        image: &M,
        encoded: Option<&M>,
        executor: &impl Executor<Layer = L, Map = M>,
    ) -> ExtractedMaps<M> {
        let stage = |blocks: &[Block<L>], x: M| {
            let blocks = blocks.iter();
            blocks.fold(x, |x, block| block.forward(x, executor))
        };
        let x = executor.layers(&self.stem, image.clone());
        let half = stage(&self.half, x);
        let sharpened = self.sharpen.as_ref().map(|_| half.clone());
        let raw = stage(&self.quarter, half);
        let skip = stage(&self.skip, raw.clone());
        let pooled = executor.averages(&skip, &self.pools);
        let branches = self.branches.iter().zip(pooled);
        let branch = |(layer, pooled): (&L, M)| executor.layer(layer, &pooled, None, true);
        let mut branches: Vec<M> = branches.map(branch).collect();
        branches.extend(encoded.map(|map| executor.layers(&self.encoded, map.clone())));
        let all = executor.concatenated([&raw, &skip], &branches);
        drop((raw, branches));
        let merged = executor.layer(&self.merge, &all, None, true);
        drop(all);
        let mut features = executor.layer(&self.project, &merged, None, false);
        drop(merged);
        let mut x = skip;
        for (blocks, project) in &self.context {
            x = stage(blocks, x);
            features = executor.plus_enlarged_layer(features, project, &x);
        }
        drop(x);
        let mut logarithm = None;
        if let Some((backbone, decoder)) = &self.backbone {
            let decoded = decoder.forward(backbone.forward(image, executor), executor);
            if let Some(decoded) = decoded {
                features = executor.plus_enlarged_layer(features, &decoder.features, &decoded);
                let map = decoder.map.as_ref();
                logarithm = map.map(|layer| executor.layer(layer, &decoded, None, false));
            }
        }
        let features = match (&self.sharpen, sharpened) {
            (Some(sharpen), Some(half)) => sharpen.forward(features, half, executor),
            _ => features,
        };
        ExtractedMaps {
            logarithm: logarithm.map(|map| executor.enlarged(&map, &features)),
            features,
        }
    }
}

impl<L> Sharpen<L> {
    fn new(
        tensors: &Tensors<'_, impl Prepare<Layer = L>>,
        half: usize,
        features: usize,
        layers: usize,
    ) -> Result<Self, WeightsError> {
        let name = |part: &str| format!("extractor.sharpen.{part}");
        let mix = |i: usize| {
            let sizes = [features, features, 3];
            tensors.conv_norm(&name(&format!("mix.{i}")), sizes, ConvSpec::same(1))
        };
        let pointwise = ConvSpec::pointwise();
        Ok(Self {
            lateral: tensors.conv(&name("lateral"), [features, half, 1], pointwise)?,
            mix: (0..layers).map(mix).collect::<Result<_, _>>()?,
            last: tensors.conv(&name("last"), [features, features, 1], pointwise)?,
        })
    }

    fn forward<M: Clone>(
        &self,
        features: M,
        half: M,
        executor: &impl Executor<Layer = L, Map = M>,
    ) -> M {
        let enlarged = executor.enlarged(&features, &half);
        drop(features);
        let x = executor.layer(&self.lateral, &half, Some(&enlarged), false);
        drop(half);
        let x = executor.layers(&self.mix, x);
        executor.layer(&self.last, &x, Some(&enlarged), false)
    }
}
