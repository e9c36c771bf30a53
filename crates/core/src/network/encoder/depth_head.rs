//! The depth head of Depth Anything V2 (Yang et al. 2024): a dense prediction transformer (DPT, Ranftl et al. 2021) on four
//! taps of an encoder. It predicts relative inverse depth.
//!
//! Each tap is resampled to its own resolution. The maps are fused from the coarsest to the finest, and upsampled between the
//! steps so that the centres of the corner pixels coincide (`align_corners = true` in `PyTorch`). The structure is defined
//! once, for any [`HeadExecutor`].

use super::Features;
use super::config::{EncoderConfig, PATCH};
use crate::bilinear::between;
use crate::error::{Error, FitError, WeightsError};
use crate::network::executor::{HeadExecutor, Prepare};
use crate::network::map::{Map, Pool};
use crate::network::tensors::Tensors;
use crate::network::workspace::Workspace;
use crate::tensor::Tensor;
use lsdc_kernels::conv::{ConvSpec, Layer};
use lsdc_kernels::schedule::InTasks;
use lsdc_kernels::simd::{Level, dot_rows};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Prefix of the tensor names of a head.
pub const DEPTH_HEAD: &str = "depth_head.";
/// Number of taps that a head uses.
const TAPS: usize = DepthHead::TAPS;

/// The layers of a depth head, each prepared for some [`HeadExecutor`].
#[derive(Debug)]
pub struct HeadLayers<L> {
    /// Channels of a tap.
    width: usize,
    /// Stages in the order of the taps: the finest map first.
    stages: Vec<Stage<L>>,
    fusions: Vec<Fusion<L>>,
    /// Convolution before the map is upsampled to the image.
    coarse: L,
    /// Convolution after the map is upsampled.
    fine: L,
    /// Weights and bias of the last layer, which has one output.
    last: (Vec<f32>, f32),
}

impl<L> HeadLayers<L> {
    /// Prepares the layers of a head from tensors by their published names (see [`DepthHead::new`]).
    ///
    /// # Errors
    /// Tensors that are missing, superfluous, or of the wrong shape.
    pub fn new(
        tensors: &BTreeMap<String, Tensor>,
        target: impl Prepare<Layer = L>,
    ) -> Result<Self, Error> {
        let parts = Parts {
            all: tensors,
            tensors: Tensors::new(tensors, target),
        };
        let [_, width, ..] = parts.shape("projects.0.weight")?;
        let [features, ..] = parts.shape("scratch.layer1_rn.weight")?;
        let [coarse, ..] = parts.shape("scratch.output_conv1.weight")?;
        let [fine, ..] = parts.shape("scratch.output_conv2.0.weight")?;
        let stages = (0..TAPS).map(|i| Stage::new(&parts, i, width, features));
        let fusions = (0..TAPS).map(|i| Fusion::new(&parts, i, features));
        let same = ConvSpec::same(1);
        let last = "scratch.output_conv2.2";
        let layers = Self {
            width,
            stages: stages.collect::<Result<_, _>>()?,
            fusions: fusions.collect::<Result<_, _>>()?,
            coarse: parts.conv("scratch.output_conv1", [coarse, features, 3], same)?,
            fine: parts.conv("scratch.output_conv2.0", [fine, coarse, 3], same)?,
            last: (
                parts
                    .values(&format!("{last}.weight"), &[1, fine, 1, 1])?
                    .to_vec(),
                parts.values(&format!("{last}.bias"), &[1])?[0],
            ),
        };
        // The first residual unit of the coarsest fusion is unused, because there is no map before it.
        for conv in ["conv1", "conv2"] {
            for part in ["weight", "bias"] {
                let name = format!("scratch.refinenet{TAPS}.resConfUnit1.{conv}.{part}");
                parts.tensors.ignore(&full(&name));
            }
        }
        parts.tensors.check_all_used()?;
        Ok(layers)
    }

    /// Channels of a tap.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Channels of each map whose pixels are expanded to blocks.
    pub fn block_channels(&self) -> impl Iterator<Item = usize> {
        self.stages.iter().filter_map(|stage| match stage.resize {
            Resize::Enlarge { channels, .. } => Some(channels),
            Resize::Keep | Resize::Halve(_) => None,
        })
    }

    /// Weights and bias of the last layer, which has one output and a ReLU.
    pub fn last(&self) -> (&[f32], f32) {
        (&self.last.0, self.last.1)
    }

    /// Computes the input of the last layer, `[14 rows, 14 columns, channels]`, from four taps of `size` (rows, columns);
    /// `None` if there are fewer taps.
    pub fn forward<M: Clone>(
        &self,
        taps: impl Iterator<Item = M>,
        size: (usize, usize),
        executor: &impl HeadExecutor<Layer = L, Map = M>,
    ) -> Option<M> {
        let stages = self.stages.iter().zip(taps);
        let mut maps: Vec<M> = stages
            .map(|(stage, tap)| stage.forward(&tap, executor))
            .collect();
        let mut fused: Option<M> = None;
        for fusion in self.fusions.iter().rev() {
            let map = maps.pop()?;
            let finer = maps.last().map(|finer| executor.size(finer));
            let size = finer.unwrap_or_else(|| {
                let (height, width) = executor.size(&map);
                (2 * height, 2 * width)
            });
            let sum = fusion.forward(map, fused.take(), executor);
            fused = Some(executor.enlarged_by_corners(&sum, size));
        }
        let fused = fused?;
        let coarse = executor.layer(&self.coarse, &fused, None, false);
        drop(fused);
        let size = (size.0 * PATCH, size.1 * PATCH);
        let fine = executor.enlarged_by_corners(&coarse, size);
        drop(coarse);
        Some(executor.layer(&self.fine, &fine, None, true))
    }
}

/// A depth head, prepared for one instruction set.
#[derive(Debug)]
pub struct DepthHead {
    level: Level,
    layers: HeadLayers<Layer>,
    workspace: Workspace,
}

impl DepthHead {
    /// Number of taps of the encoder that a head uses.
    pub const TAPS: usize = 4;

    /// Prepares a head from tensors by their published names, `depth_head.projects.0.weight` and so on. All sizes are
    /// read from the tensors. `depth_head.scratch.refinenet4.resConfUnit1`, which is not used, may be missing.
    ///
    /// # Errors
    /// Tensors that are missing, superfluous, or of the wrong shape.
    pub fn new(tensors: &BTreeMap<String, Tensor>, level: Level) -> Result<Self, Error> {
        Ok(Self {
            level,
            layers: HeadLayers::new(tensors, level)?,
            workspace: Workspace::default(),
        })
    }

    /// Channels of a tap.
    pub fn width(&self) -> usize {
        self.layers.width
    }

    /// Predicts relative inverse depth, `[14 rows, 14 columns]`, from the features of the encoder at four taps.
    ///
    /// # Errors
    /// The number of taps differs, or they belong to another encoder.
    pub fn predict(&self, features: &Features) -> Result<Vec<f32>, FitError> {
        let (rows, columns) = (features.rows, features.columns);
        let expected = rows * columns * self.width();
        let fits = |tap: &Vec<f32>| tap.len() == expected && expected > 0;
        if features.taps.len() != TAPS || !features.taps.iter().all(fits) {
            let (taps, width) = (features.taps.len(), self.width());
            return Err(FitError::Shape(format!(
                "{taps} taps of an encoder are not {TAPS} of {rows}x{columns} patches with {width} channels"
            )));
        }
        // Run on a thread of the pool, to avoid waiting for the pool at each step.
        Ok(rayon::scope(|_| self.run(features)))
    }

    /// Checks that the encoder has as many taps as the head, with the same number of channels.
    ///
    /// # Errors
    /// The number of taps or their width differs.
    pub fn check(&self, encoder: &EncoderConfig) -> Result<(), WeightsError> {
        if encoder.taps.len() == TAPS && encoder.width == self.width() {
            return Ok(());
        }
        let what = "its depth head reads the features of another encoder";
        Err(WeightsError::Unsupported(what))
    }

    /// Frees cached memory.
    pub fn release(&self) {
        self.workspace.clear();
    }

    fn run(&self, features: &Features) -> Vec<f32> {
        let workspace = &self.workspace;
        let (rows, columns) = (features.rows, features.columns);
        let taps = features.taps.iter();
        let taps = taps.map(|tap| {
            let map = workspace.pool.copy(tap, rows, columns, self.width());
            Arc::new(map)
        });
        let fine = self.layers.forward(taps, (rows, columns), workspace);
        fine.map_or_else(Vec::new, |fine| self.inverse_depths(&fine))
    }

    /// Applies the last layer and its ReLU.
    fn inverse_depths(&self, map: &Map) -> Vec<f32> {
        let (weights, bias) = self.layers.last();
        let mut output = vec![0.0; map.pixels()];
        let lines = output.par_chunks_exact_mut(map.width);
        let rows = map.values.par_chunks_exact(map.width * map.channels());
        lines.zip(rows).each(|(line, row)| {
            dot_rows(self.level, row, weights, bias, line);
            for value in line {
                *value = value.max(0.0);
            }
        });
        output
    }
}

/// Returns the name of a tensor in a file.
fn full(name: &str) -> String {
    format!("{DEPTH_HEAD}{name}")
}

/// The tensors of a head, by their names without the prefix.
struct Parts<'a, P> {
    all: &'a BTreeMap<String, Tensor>,
    tensors: Tensors<'a, P>,
}

impl<'a, P: Prepare> Parts<'a, P> {
    /// Returns the shape of the weights of a convolution; no side is 0.
    fn shape(&self, name: &str) -> Result<[usize; 4], WeightsError> {
        let name = full(name);
        let tensor = self.all.get(&name);
        let tensor = tensor.ok_or_else(|| WeightsError::tensor(&name, "is missing"))?;
        let found = tensor.shape();
        match <[usize; 4]>::try_from(found) {
            Ok(shape) if !shape.contains(&0) => Ok(shape),
            _ => {
                let what = format!("has shape {found:?}, expected four sides above 0");
                Err(WeightsError::tensor(&name, what))
            }
        }
    }

    fn values(&self, name: &str, shape: &[usize]) -> Result<&'a [f32], WeightsError> {
        self.tensors.values(&full(name), shape)
    }

    /// Prepares a convolution with a bias.
    fn conv(
        &self,
        name: &str,
        [outputs, channels, taps]: [usize; 3],
        spec: ConvSpec,
    ) -> Result<P::Layer, WeightsError> {
        let shape = [outputs, channels, taps, taps];
        let weights = self.values(&format!("{name}.weight"), &shape)?;
        let bias = self.values(&format!("{name}.bias"), &[outputs])?;
        let sizes = [outputs, channels, taps];
        Ok(self.tensors.target.layer(weights, sizes, bias, spec))
    }

    /// Prepares a transposed convolution, whose stride is its kernel size, as the 1x1 convolution for
    /// [`HeadExecutor::in_blocks`]; also returns the kernel size.
    fn transposed(&self, name: &str, channels: usize) -> Result<(P::Layer, usize), WeightsError> {
        let weight = format!("{name}.weight");
        let [_, _, side, _] = self.shape(&weight)?;
        // The first axis is the input channels.
        let values = self.values(&weight, &[channels, channels, side, side])?;
        let bias = self.values(&format!("{name}.bias"), &[channels])?;
        let area = side * side;
        let outputs = (0..area).flat_map(|place| (0..channels).map(move |output| (place, output)));
        let weights: Vec<f32> = outputs
            .flat_map(|(place, output)| {
                (0..channels).map(move |input| values[(input * channels + output) * area + place])
            })
            .collect();
        let sizes = [area * channels, channels, 1];
        let bias = bias.repeat(area);
        let pointwise = ConvSpec::pointwise();
        Ok((
            self.tensors.target.layer(&weights, sizes, &bias, pointwise),
            side,
        ))
    }
}

/// Maps a tap to the resolution and channels of the fusion.
#[derive(Debug)]
struct Stage<L> {
    project: L,
    resize: Resize<L>,
    mix: L,
}

/// Resampling of a tap to its resolution.
#[derive(Debug)]
enum Resize<L> {
    /// Each pixel is expanded to a block.
    Enlarge {
        layer: L,
        side: usize,
        channels: usize,
    },
    Keep,
    Halve(L),
}

impl<L> Stage<L> {
    fn new(
        parts: &Parts<'_, impl Prepare<Layer = L>>,
        index: usize,
        width: usize,
        features: usize,
    ) -> Result<Self, WeightsError> {
        let project = format!("projects.{index}");
        let [own, ..] = parts.shape(&format!("{project}.weight"))?;
        let name = format!("resize_layers.{index}");
        let resize = match index {
            0 | 1 => {
                let (layer, side) = parts.transposed(&name, own)?;
                Resize::Enlarge {
                    layer,
                    side,
                    channels: own,
                }
            }
            2 => Resize::Keep,
            _ => Resize::Halve(parts.conv(&name, [own, own, 3], ConvSpec::halving())?),
        };
        let mix = full(&format!("scratch.layer{}_rn", index + 1));
        Ok(Self {
            project: parts.conv(&project, [own, width, 1], ConvSpec::pointwise())?,
            resize,
            mix: parts
                .tensors
                .conv(&mix, [features, own, 3], ConvSpec::same(1))?,
        })
    }

    fn forward<M: Clone>(&self, tap: &M, executor: &impl HeadExecutor<Layer = L, Map = M>) -> M {
        let map = executor.layer(&self.project, tap, None, false);
        let map = match &self.resize {
            Resize::Enlarge { layer, side, .. } => executor.in_blocks(layer, *side, &map),
            Resize::Keep => map,
            Resize::Halve(layer) => executor.layer(layer, &map, None, false),
        };
        executor.layer(&self.mix, &map, None, false)
    }
}

/// A fusion step from a coarser map to a finer one.
#[derive(Debug)]
struct Fusion<L> {
    /// Residual unit for the finer map; `None` in the first step.
    before: Option<ResidualUnit<L>>,
    after: ResidualUnit<L>,
    project: L,
}

impl<L> Fusion<L> {
    fn new(
        parts: &Parts<'_, impl Prepare<Layer = L>>,
        index: usize,
        features: usize,
    ) -> Result<Self, WeightsError> {
        let name = format!("scratch.refinenet{}", index + 1);
        let unit =
            |unit: usize| ResidualUnit::new(parts, &format!("{name}.resConfUnit{unit}"), features);
        let before = (index + 1 < TAPS).then(|| unit(1));
        let sizes = [features, features, 1];
        Ok(Self {
            before: before.transpose()?,
            after: unit(2)?,
            project: parts.conv(&format!("{name}.out_conv"), sizes, ConvSpec::pointwise())?,
        })
    }

    /// Returns the fused map at the resolution of `map`. The projection commutes with the upsampling and precedes it.
    fn forward<M: Clone>(
        &self,
        map: M,
        coarser: Option<M>,
        executor: &impl HeadExecutor<Layer = L, Map = M>,
    ) -> M {
        let sum = match (&self.before, coarser) {
            (Some(before), Some(coarser)) => {
                let skip = executor.sum(&map, &coarser);
                before.changed(&map, &skip, executor)
            }
            _ => map,
        };
        let sum = self.after.changed(&sum, &sum, executor);
        executor.layer(&self.project, &sum, None, false)
    }
}

/// Two convolutions, each after a ReLU; their output is added to the input.
#[derive(Debug)]
struct ResidualUnit<L> {
    first: L,
    second: L,
}

impl<L> ResidualUnit<L> {
    fn new(
        parts: &Parts<'_, impl Prepare<Layer = L>>,
        name: &str,
        features: usize,
    ) -> Result<Self, WeightsError> {
        let conv = |part: &str| {
            let sizes = [features, features, 3];
            parts.conv(&format!("{name}.{part}"), sizes, ConvSpec::same(1))
        };
        Ok(Self {
            first: conv("conv1")?,
            second: conv("conv2")?,
        })
    }

    /// Returns the output of the layers for `map`, plus `skip`.
    fn changed<M: Clone>(
        &self,
        map: &M,
        skip: &M,
        executor: &impl HeadExecutor<Layer = L, Map = M>,
    ) -> M {
        let map = executor.rectified(map);
        let map = executor.layer(&self.first, &map, None, true);
        executor.layer(&self.second, &map, Some(skip), false)
    }
}

impl HeadExecutor for Workspace {
    fn size(&self, map: &Arc<Map>) -> (usize, usize) {
        (map.height, map.width)
    }

    fn rectified(&self, map: &Arc<Map>) -> Arc<Map> {
        let mut output = self.pool.take(map.height, map.width, map.channels());
        let row = map.width * map.channels();
        let rows = output.values.par_chunks_exact_mut(row);
        rows.zip(map.values.par_chunks_exact(row))
            .each(|(output, values)| {
                for (output, value) in output.iter_mut().zip(values) {
                    *output = if *value > 0.0 { *value } else { 0.0 };
                }
            });
        Arc::new(output)
    }

    fn sum(&self, one: &Arc<Map>, other: &Arc<Map>) -> Arc<Map> {
        let mut output = one.copied();
        let row = one.width * one.channels();
        let rows = output.values.par_chunks_exact_mut(row);
        rows.zip(other.values.par_chunks_exact(row))
            .each(|(output, values)| {
                for (output, value) in output.iter_mut().zip(values) {
                    *output += value;
                }
            });
        Arc::new(output)
    }

    fn in_blocks(&self, layer: &Layer, side: usize, x: &Arc<Map>) -> Arc<Map> {
        let product = self.layer(layer, x, None, false);
        let channels = product.channels() / (side * side);
        let (height, width) = (side * x.height, side * x.width);
        let mut output = self.pool.take(height, width, channels);
        // The pixels of one block in one row of the output are contiguous, in the output and in the product.
        let run = side * channels;
        let row = width * channels;
        let blocks = output.values.par_chunks_exact_mut(side * row);
        blocks
            .zip(product.values.par_chunks_exact(side * row))
            .each(|(block, product)| {
                for (x, runs) in product.chunks_exact(side * run).enumerate() {
                    for (i, values) in runs.chunks_exact(run).enumerate() {
                        block[i * row + x * run..][..run].copy_from_slice(values);
                    }
                }
            });
        Arc::new(output)
    }

    fn enlarged_by_corners(&self, map: &Arc<Map>, size: (usize, usize)) -> Arc<Map> {
        Arc::new(enlarged(map, size, Level::here(), &self.pool))
    }
}

/// For each of `to` pixels, returns the two of `from` pixels around it, and the weight of the second; the first and the last
/// pixels of both axes coincide.
fn axis(from: usize, to: usize) -> Vec<(usize, usize, f32)> {
    let step = from.saturating_sub(1) as f64 / to.saturating_sub(1).max(1) as f64;
    let places = (0..to).map(|i| between(i as f64 * step, from));
    places
        .map(|(low, high, share)| (low, high, share as f32))
        .collect()
}

/// Upsamples a map bilinearly to a height and width, with coinciding corner pixels.
fn enlarged(map: &Map, (height, width): (usize, usize), level: Level, pool: &Pool) -> Map {
    let channels = map.channels();
    let mut output = pool.take(height, width, channels);
    let (down, across) = (axis(map.height, height), axis(map.width, width));
    let row = map.width * channels;
    let rows = output.values.par_chunks_exact_mut(width * channels);
    rows.zip(&down).each(|(output, &(top, bottom, v))| {
        let mut line = vec![0.0; row];
        level.vectorised(
            #[inline(always)]
            || {
                let upper = &map.values[top * row..][..row];
                let lower = &map.values[bottom * row..][..row];
                for (value, (a, b)) in line.iter_mut().zip(upper.iter().zip(lower)) {
                    *value = a + (b - a) * v;
                }
                for (pixel, &(left, right, u)) in output.chunks_exact_mut(channels).zip(&across) {
                    let left = &line[left * channels..][..channels];
                    let right = &line[right * channels..][..channels];
                    for (value, (a, b)) in pixel.iter_mut().zip(left.iter().zip(right)) {
                        *value = a + (b - a) * u;
                    }
                }
            },
        );
    });
    output
}
