//! The feature extractor, layer by layer.

use super::backbone::Backbone;
use super::config::{ExtractorConfig, StageConfig};
use super::decoder::Decoder;
use super::map::Map;
use super::tensors::Tensors;
use super::workspace::Workspace;
use crate::error::WeightsError;
use lsdc_kernels::conv::{ConvSpec, Layer};
use lsdc_kernels::schedule::InTasks;
use lsdc_kernels::simd::Level;
use rayon::prelude::*;

#[derive(Debug)]
pub(super) struct Extractor {
    stem: Vec<Layer>,
    half: Vec<Block>,
    quarter: Vec<Block>,
    /// Wider, then dilated.
    skip: Vec<Block>,
    /// Pool size and convolution of each branch.
    branches: Vec<(usize, Layer)>,
    /// Of the encoder's features, at their resolution.
    encoded: Vec<Layer>,
    merge: Layer,
    project: Layer,
    /// Blocks at lower and lower resolutions, and what each adds to the features.
    context: Vec<(Vec<Block>, Layer)>,
    backbone: Option<(Backbone, Decoder)>,
    sharpen: Option<Sharpen>,
}

/// What an extractor yields.
pub(super) struct ExtractorOutput {
    /// At a quarter of the image's resolution, or at half of it if they are sharpened.
    pub(super) features: Map,
    /// The logarithm of the map of depth that a backbone predicts, at the same resolution.
    pub(super) logarithm: Option<Map>,
}

#[derive(Debug)]
struct Sharpen {
    lateral: Layer,
    mix: Vec<Layer>,
    last: Layer,
}

#[derive(Debug)]
struct Block {
    first: Layer,
    second: Layer,
    shortcut: Option<Layer>,
}

impl Block {
    /// A run of blocks, of which the first changes width and resolution.
    fn stage(
        tensors: &Tensors<'_>,
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

    fn forward(&self, x: Map, workspace: &Workspace) -> Map {
        let inner = workspace.layer(&self.first, &x, None, true);
        let shortcut = match &self.shortcut {
            None => x,
            Some(layer) => {
                let shortcut = workspace.layer(layer, &x, None, false);
                drop(x);
                shortcut
            }
        };
        workspace.layer(&self.second, &inner, Some(&shortcut), false)
    }
}

impl Extractor {
    /// `channels` are those of the encoder's features, if there is an encoder; `mean` is whether the network predicts a
    /// map of depth.
    pub(super) fn new(
        config: &ExtractorConfig,
        channels: Option<usize>,
        mean: bool,
        tensors: &Tensors<'_>,
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
        let branch = |(i, &pool): (usize, &usize)| {
            let name = format!("extractor.branches.{i}");
            let sizes = [config.branch, fourth.width, 1];
            Ok((pool, tensors.conv_norm(&name, sizes, pointwise)?))
        };
        let branches = config.pools.iter().enumerate().map(branch);
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
            branches: branches.collect::<Result<_, WeightsError>>()?,
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

    pub(super) fn forward(
        &self,
        image: &Map,
        encoded: Option<&Map>,
        workspace: &Workspace,
    ) -> ExtractorOutput {
        let stage = |blocks: &[Block], x: Map| {
            let blocks = blocks.iter();
            blocks.fold(x, |x, block| block.forward(x, workspace))
        };
        let x = workspace.layers(&self.stem, image.copied());
        let half = stage(&self.half, x);
        let half_copy = self.sharpen.as_ref().map(|_| half.copied());
        let raw = stage(&self.quarter, half);
        let skip = stage(&self.skip, raw.copied());
        let branch = |(size, layer): &(usize, Layer)| {
            let pooled = averages(&skip, *size);
            workspace.layer(layer, &pooled, None, true)
        };
        let mut branches: Vec<Map> = self.branches.iter().map(branch).collect();
        branches.extend(encoded.map(|map| workspace.layers(&self.encoded, map.copied())));
        let all = concatenated(&raw, &skip, &branches);
        drop((raw, branches));
        let merged = workspace.layer(&self.merge, &all, None, true);
        drop(all);
        let mut features = workspace.layer(&self.project, &merged, None, false);
        drop(merged);
        let mut x = skip;
        for (blocks, project) in &self.context {
            x = stage(blocks, x);
            features.add_enlarged(&workspace.layer(project, &x, None, false));
        }
        drop(x);
        let mut logarithm = None;
        if let Some((backbone, decoder)) = &self.backbone {
            let decoded = decoder.forward(backbone.forward(image, workspace), workspace);
            features.add_enlarged(&workspace.layer(&decoder.features, &decoded, None, false));
            let map = decoder.map.as_ref();
            logarithm = map.map(|layer| workspace.layer(layer, &decoded, None, false));
        }
        let features = match (&self.sharpen, half_copy) {
            (Some(sharpen), Some(half)) => sharpen.forward(features, half, workspace),
            _ => features,
        };
        ExtractorOutput {
            logarithm: logarithm.map(|map| map.enlarged(features.height, features.width)),
            features,
        }
    }
}

impl Sharpen {
    fn new(
        tensors: &Tensors<'_>,
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

    fn forward(&self, features: Map, half: Map, workspace: &Workspace) -> Map {
        let enlarged = features.enlarged(half.height, half.width);
        drop(features);
        let x = workspace.layer(&self.lateral, &half, Some(&enlarged), false);
        drop(half);
        let x = workspace.layers(&self.mix, x);
        workspace.layer(&self.last, &x, Some(&enlarged), false)
    }
}

/// Concatenates the channels of all maps, the branches enlarged bilinearly.
fn concatenated(raw: &Map, skip: &Map, branches: &[Map]) -> Map {
    let maps = [raw, skip].into_iter().chain(branches);
    let channels: usize = maps.map(Map::channels).sum();
    let mut all = raw.pool.take(raw.height, raw.width, channels);
    let level = Level::here();
    let rows = all.values.par_chunks_exact_mut(raw.width * channels);
    rows.enumerate().each(|(y, row)| {
        level.vectorised(
            #[inline(always)]
            || {
                for (x, pixel) in row.chunks_exact_mut(channels).enumerate() {
                    let mut remaining = pixel;
                    for map in [raw, skip] {
                        let (own, others) = remaining.split_at_mut(map.channels());
                        let from = (y * raw.width + x) * own.len();
                        own.copy_from_slice(&map.values[from..from + own.len()]);
                        remaining = others;
                    }
                    for map in branches {
                        let (own, others) = remaining.split_at_mut(map.channels());
                        map.enlarged_pixel((y, raw.height), (x, raw.width), own);
                        remaining = others;
                    }
                }
            },
        );
    });
    all
}

/// Means over windows of `size` pixels, cut off at the end.
fn averages(map: &Map, size: usize) -> Map {
    let (height, width) = (map.height.div_ceil(size), map.width.div_ceil(size));
    let channels = map.channels();
    let mut output = map.pool.take(height, width, channels);
    output.values.fill(0.0);
    let rows = output
        .values
        .par_chunks_exact_mut(width * channels)
        .enumerate();
    rows.each(|(window_row, sums)| {
        let rows = window_row * size..((window_row + 1) * size).min(map.height);
        for y in rows.clone() {
            let row = &map.values[y * map.width * channels..][..map.width * channels];
            for (x, pixel) in row.chunks_exact(channels).enumerate() {
                let sum = &mut sums[x / size * channels..][..channels];
                sum.iter_mut().zip(pixel).for_each(|(s, v)| *s += v);
            }
        }
        for (window, sum) in sums.chunks_exact_mut(channels).enumerate() {
            let columns = size.min(map.width - window * size);
            let scale = 1.0 / (rows.len() * columns) as f32;
            for value in sum {
                *value *= scale;
            }
        }
    });
    output
}
