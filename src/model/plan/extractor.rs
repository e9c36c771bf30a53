//! The feature extractor, layer by layer.

use super::map::{Map, Pool};
use super::run::Run;
use crate::conv::Layer;
use crate::model::extractor::{Block, Extractor, Sharpen};
use crate::simd::Level;
use rayon::prelude::*;

#[derive(Debug)]
pub(super) struct ExtractorPlan {
    stem: Vec<Layer>,
    half: Vec<BlockPlan>,
    quarter: Vec<BlockPlan>,
    /// Wider, then dilated.
    skip: Vec<BlockPlan>,
    /// Pool size and convolution of each branch.
    branches: Vec<(usize, Layer)>,
    merge: Layer,
    project: Layer,
    sharpen: Option<SharpenPlan>,
}

#[derive(Debug)]
struct SharpenPlan {
    lateral: Layer,
    mix: Vec<Layer>,
    last: Layer,
}

#[derive(Debug)]
struct BlockPlan {
    first: Layer,
    second: Layer,
    shortcut: Option<Layer>,
}

impl Run<'_> {
    fn block(self, block: &BlockPlan, x: Map) -> Map {
        let inner = self.layer(&block.first, &x, None, true);
        let shortcut = match &block.shortcut {
            None => x,
            Some(layer) => {
                let shortcut = self.layer(layer, &x, None, false);
                self.pool.give(x);
                shortcut
            }
        };
        let output = self.layer(&block.second, &inner, Some(&shortcut), false);
        self.pool.give(inner);
        self.pool.give(shortcut);
        output
    }
}

impl ExtractorPlan {
    pub(super) fn new(net: &Extractor, level: Level) -> Option<Self> {
        let block = |block: &Block| {
            Some(BlockPlan {
                first: block.first.folded(level)?,
                second: block.second.folded(level)?,
                shortcut: match &block.shortcut {
                    None => None,
                    Some(conv) => Some(conv.folded(level)?),
                },
            })
        };
        let blocks = |stage: &[Block]| stage.iter().map(block).collect::<Option<Vec<_>>>();
        let mut skip = blocks(&net.wide)?;
        skip.extend(blocks(&net.dilated)?);
        let branches = net.pools.iter().zip(&net.branches);
        Some(Self {
            stem: net
                .stem
                .iter()
                .map(|conv| conv.folded(level))
                .collect::<Option<_>>()?,
            half: blocks(&net.half)?,
            quarter: blocks(&net.quarter)?,
            skip,
            branches: branches
                .map(|(&pool, conv)| Some((pool, conv.folded(level)?)))
                .collect::<Option<_>>()?,
            merge: net.merge.folded(level)?,
            project: net.project.prepared(level),
            sharpen: match &net.sharpen {
                None => None,
                Some(net) => Some(SharpenPlan::new(net, level)?),
            },
        })
    }

    /// Features at a quarter of the image's resolution, or at half of it if they are sharpened.
    pub(super) fn forward(&self, image: &Map, run: Run<'_>) -> Map {
        let pool = run.pool;
        let x = self.stem.iter().fold(image.copied(pool), |x, layer| {
            let output = run.layer(layer, &x, None, true);
            pool.give(x);
            output
        });
        let half = self.half.iter().fold(x, |x, block| run.block(block, x));
        let kept = self.sharpen.as_ref().map(|_| half.copied(pool));
        let raw = self
            .quarter
            .iter()
            .fold(half, |x, block| run.block(block, x));
        let copy = raw.copied(pool);
        let skip = self.skip.iter().fold(copy, |x, block| run.block(block, x));
        let branches: Vec<Map> = self
            .branches
            .iter()
            .map(|(size, layer)| {
                let pooled = averages(&skip, *size, pool);
                let output = run.layer(layer, &pooled, None, true);
                pool.give(pooled);
                output
            })
            .collect();
        let all = gather(&raw, &skip, &branches, pool);
        for map in branches.into_iter().chain([raw, skip]) {
            pool.give(map);
        }
        let merged = run.layer(&self.merge, &all, None, true);
        pool.give(all);
        let features = run.layer(&self.project, &merged, None, false);
        pool.give(merged);
        match (&self.sharpen, kept) {
            (Some(sharpen), Some(half)) => sharpen.forward(features, half, run),
            _ => features,
        }
    }
}

impl SharpenPlan {
    fn new(net: &Sharpen, level: Level) -> Option<Self> {
        Some(Self {
            lateral: net.lateral.prepared(level),
            mix: net
                .mix
                .iter()
                .map(|conv| conv.folded(level))
                .collect::<Option<_>>()?,
            last: net.last.prepared(level),
        })
    }

    fn forward(&self, features: Map, half: Map, run: Run<'_>) -> Map {
        let pool = run.pool;
        let mut enlarged = pool.take(half.height, half.width, features.channels());
        enlarged.values.fill(0.0);
        enlarged.add_enlarged(&features);
        pool.give(features);
        let x = run.layer(&self.lateral, &half, Some(&enlarged), false);
        pool.give(half);
        let x = self.mix.iter().fold(x, |x, layer| {
            let output = run.layer(layer, &x, None, true);
            pool.give(x);
            output
        });
        let sharp = run.layer(&self.last, &x, Some(&enlarged), false);
        pool.give(x);
        pool.give(enlarged);
        sharp
    }
}

/// Puts all maps side by side, the branches enlarged bilinearly.
fn gather(raw: &Map, skip: &Map, branches: &[Map], pool: &Pool) -> Map {
    let maps = [raw, skip].into_iter().chain(branches);
    let channels: usize = maps.map(Map::channels).sum();
    let mut all = pool.take(raw.height, raw.width, channels);
    let rows = all.values.par_chunks_exact_mut(raw.width * channels);
    rows.enumerate().for_each(|(y, row)| {
        for (x, pixel) in row.chunks_exact_mut(channels).enumerate() {
            let mut rest = pixel;
            for map in [raw, skip] {
                let (own, others) = rest.split_at_mut(map.channels());
                let from = (y * raw.width + x) * own.len();
                own.copy_from_slice(&map.values[from..from + own.len()]);
                rest = others;
            }
            for map in branches {
                let (own, others) = rest.split_at_mut(map.channels());
                map.enlarged((y, raw.height), (x, raw.width), own);
                rest = others;
            }
        }
    });
    all
}

/// Means over windows of `size` pixels, cut off at the end.
fn averages(map: &Map, size: usize, pool: &Pool) -> Map {
    let (height, width) = (map.height.div_ceil(size), map.width.div_ceil(size));
    let channels = map.channels();
    let mut output = pool.take(height, width, channels);
    output.values.fill(0.0);
    let rows = output
        .values
        .par_chunks_exact_mut(width * channels)
        .enumerate();
    rows.for_each(|(window_row, sums)| {
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
