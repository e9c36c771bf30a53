//! The depth head of Depth Anything V2 (Yang et al. 2024): a dense prediction transformer (DPT, Ranftl et al. 2021) on
//! four taps of an encoder, which predicts relative inverse depth.
//!
//! Each tap becomes a map of its own resolution. The maps are fused from the coarsest to the finest, enlarged between
//! the steps so that the centres of the corner pixels coincide (`align_corners = true` in `PyTorch`).

use super::Features;
use super::config::{EncoderConfig, PATCH};
use crate::bilinear::between;
use crate::error::{Error, FitError, WeightsError};
use crate::network::map::{Map, Pool};
use crate::network::tensors::Tensors;
use crate::network::workspace::Workspace;
use crate::tensor::Tensor;
use lsdc_kernels::conv::{ConvSpec, Layer};
use lsdc_kernels::schedule::InTasks;
use lsdc_kernels::simd::{Level, Packed, Tail, dot_rows};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// What the names of the tensors of a head begin with.
pub const DEPTH_HEAD: &str = "depth_head.";
/// Taps that a head reads.
const TAPS: usize = DepthHead::TAPS;

/// A depth head, prepared for one instruction set.
#[derive(Debug)]
pub struct DepthHead {
    level: Level,
    /// Channels of a tap.
    width: usize,
    /// In the order of the taps: the finest map first.
    stages: Vec<Stage>,
    fusions: Vec<Fusion>,
    /// Before the map is enlarged to the image.
    coarse: Layer,
    /// After that.
    fine: Layer,
    /// Weights and bias of the last layer, which has one output.
    last: (Vec<f32>, f32),
    workspace: Workspace,
}

impl DepthHead {
    /// Taps of the encoder that a head reads.
    pub const TAPS: usize = 4;

    /// Prepares a head from tensors by their published names, `depth_head.projects.0.weight` and so on. All sizes are
    /// read from the tensors. `depth_head.scratch.refinenet4.resConfUnit1`, which is not used, may be missing.
    ///
    /// # Errors
    /// Tensors that are missing, superfluous, or of shapes that do not match.
    pub fn new(tensors: &BTreeMap<String, Tensor>, level: Level) -> Result<Self, Error> {
        let parts = Parts {
            all: tensors,
            tensors: Tensors::new(tensors, level),
        };
        let [_, width, ..] = parts.shape("projects.0.weight")?;
        let [features, ..] = parts.shape("scratch.layer1_rn.weight")?;
        let [coarse, ..] = parts.shape("scratch.output_conv1.weight")?;
        let [fine, ..] = parts.shape("scratch.output_conv2.0.weight")?;
        let stages = (0..TAPS).map(|i| Stage::new(&parts, i, width, features));
        let fusions = (0..TAPS).map(|i| Fusion::new(&parts, i, features));
        let same = ConvSpec::same(1);
        let last = "scratch.output_conv2.2";
        let head = Self {
            level,
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
            workspace: Workspace::default(),
        };
        // The coarsest map is fused with none before it.
        for conv in ["conv1", "conv2"] {
            for part in ["weight", "bias"] {
                let name = format!("scratch.refinenet{TAPS}.resConfUnit1.{conv}.{part}");
                parts.tensors.ignore(&full(&name));
            }
        }
        parts.tensors.check_all_used()?;
        Ok(head)
    }

    /// Channels of a tap.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Relative inverse depth, `[14 rows, 14 columns]`, from the features of the encoder at four taps.
    ///
    /// # Errors
    /// Another number of taps, or taps of another encoder.
    pub fn predict(&self, features: &Features) -> Result<Vec<f32>, FitError> {
        let (rows, columns) = (features.rows, features.columns);
        let expected = rows * columns * self.width;
        let fits = |tap: &Vec<f32>| tap.len() == expected && expected > 0;
        if features.taps.len() != TAPS || !features.taps.iter().all(fits) {
            let (taps, width) = (features.taps.len(), self.width);
            return Err(FitError::Shape(format!(
                "{taps} taps of an encoder are not {TAPS} of {rows}x{columns} patches with {width} channels"
            )));
        }
        // On a thread of the pool, which need not be awaited for each step.
        Ok(rayon::scope(|_| self.run(features)))
    }

    /// Checks that the head reads as many taps, as wide, as an encoder has.
    ///
    /// # Errors
    /// It does not.
    pub fn check(&self, encoder: &EncoderConfig) -> Result<(), WeightsError> {
        if encoder.taps.len() == TAPS && encoder.width == self.width {
            return Ok(());
        }
        let what = "its depth head reads the features of another encoder";
        Err(WeightsError::Unsupported(what))
    }

    /// Frees the memory that is kept for further images.
    pub fn release(&self) {
        self.workspace.clear();
    }

    fn run(&self, features: &Features) -> Vec<f32> {
        let workspace = &self.workspace;
        let (rows, columns) = (features.rows, features.columns);
        let read = |(stage, tap): (&Stage, &Vec<f32>)| {
            let tap = workspace.pool.copy(tap, rows, columns, self.width);
            stage.forward(&tap, workspace)
        };
        let mut maps: Vec<Map> = self.stages.iter().zip(&features.taps).map(read).collect();
        let mut fused: Option<Map> = None;
        for fusion in self.fusions.iter().rev() {
            let Some(map) = maps.pop() else { break };
            let size = match maps.last() {
                Some(finer) => (finer.height, finer.width),
                None => (2 * map.height, 2 * map.width),
            };
            let sum = fusion.forward(map, fused.take(), workspace);
            fused = Some(enlarged(&sum, size, self.level, &workspace.pool));
        }
        let fused = fused.unwrap_or_default();
        let coarse = workspace.layer(&self.coarse, &fused, None, false);
        drop(fused);
        let size = (rows * PATCH, columns * PATCH);
        let fine = enlarged(&coarse, size, self.level, &workspace.pool);
        let fine = workspace.layer(&self.fine, &fine, None, true);
        self.inverse_depths(&fine)
    }

    /// The last layer, which no negative number leaves.
    fn inverse_depths(&self, map: &Map) -> Vec<f32> {
        let (weights, bias) = &self.last;
        let mut output = vec![0.0; map.pixels()];
        let lines = output.par_chunks_exact_mut(map.width);
        let rows = map.values.par_chunks_exact(map.width * map.channels());
        lines.zip(rows).each(|(line, row)| {
            dot_rows(self.level, row, weights, *bias, line);
            for value in line {
                *value = value.max(0.0);
            }
        });
        output
    }
}

/// The name of a tensor in a file.
fn full(name: &str) -> String {
    format!("{DEPTH_HEAD}{name}")
}

/// The tensors of a head, by their names after the prefix.
struct Parts<'a> {
    all: &'a BTreeMap<String, Tensor>,
    tensors: Tensors<'a>,
}

impl<'a> Parts<'a> {
    /// The sides of a tensor of a convolution, none of which is 0.
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

    /// A convolution with a bias.
    fn conv(
        &self,
        name: &str,
        [outputs, channels, taps]: [usize; 3],
        spec: ConvSpec,
    ) -> Result<Layer, WeightsError> {
        let shape = [outputs, channels, taps, taps];
        let weights = self.values(&format!("{name}.weight"), &shape)?;
        let bias = self.values(&format!("{name}.bias"), &[outputs])?;
        let sizes = [outputs, channels, taps];
        Ok(Layer::new(self.tensors.target, weights, sizes, bias, spec))
    }
}

/// From a tap to a map of the resolution and channels that are fused.
#[derive(Debug)]
struct Stage {
    project: Layer,
    resize: Resize,
    mix: Layer,
}

/// How the map of a tap gets its resolution.
#[derive(Debug)]
enum Resize {
    Enlarge(TransposedConv),
    Keep,
    Halve(Layer),
}

impl Stage {
    fn new(
        parts: &Parts<'_>,
        index: usize,
        width: usize,
        features: usize,
    ) -> Result<Self, WeightsError> {
        let project = format!("projects.{index}");
        let [own, ..] = parts.shape(&format!("{project}.weight"))?;
        let name = format!("resize_layers.{index}");
        let resize = match index {
            0 | 1 => Resize::Enlarge(TransposedConv::new(parts, &name, own)?),
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

    fn forward(&self, tap: &Map, workspace: &Workspace) -> Map {
        let map = workspace.layer(&self.project, tap, None, false);
        let map = match &self.resize {
            Resize::Enlarge(conv) => conv.forward(&map, workspace),
            Resize::Keep => map,
            Resize::Halve(layer) => workspace.layer(layer, &map, None, false),
        };
        workspace.layer(&self.mix, &map, None, false)
    }
}

/// A transposed convolution whose stride is the side of its kernel: each pixel becomes a block of pixels.
#[derive(Debug)]
struct TransposedConv {
    /// `[channels, factor x factor x channels]`
    weights: Packed,
    factor: usize,
}

impl TransposedConv {
    fn new(parts: &Parts<'_>, name: &str, channels: usize) -> Result<Self, WeightsError> {
        let weight = format!("{name}.weight");
        let [_, _, factor, _] = parts.shape(&weight)?;
        // Inputs first.
        let values = parts.values(&weight, &[channels, channels, factor, factor])?;
        let bias = parts.values(&format!("{name}.bias"), &[channels])?;
        let area = factor * factor;
        let at = |row: usize, column: usize| {
            let (place, output) = (column / channels, column % channels);
            values[(row * channels + output) * area + place]
        };
        let sizes = (channels, area * channels);
        Ok(Self {
            weights: Packed::new(parts.tensors.target, sizes, &bias.repeat(area), at),
            factor,
        })
    }

    fn forward(&self, map: &Map, workspace: &Workspace) -> Map {
        let (factor, channels) = (self.factor, map.channels());
        let (height, width) = (factor * map.height, factor * map.width);
        let mut output = workspace.pool.take(height, width, channels);
        // The pixels that one pixel becomes in one row of the output lie side by side, here as in the product.
        let run = factor * channels;
        let row = width * channels;
        let blocks = output.values.par_chunks_exact_mut(factor * row);
        let inputs = map.values.par_chunks_exact(map.width * channels);
        let scratch = &workspace.scratch;
        blocks.zip(inputs).each(|(block, input)| {
            scratch.with(block.len(), |product| {
                self.weights.apply(input, Tail::default(), product);
                for (x, runs) in product.chunks_exact(factor * run).enumerate() {
                    for (i, values) in runs.chunks_exact(run).enumerate() {
                        block[i * row + x * run..][..run].copy_from_slice(values);
                    }
                }
            });
        });
        output
    }
}

/// A step from a coarser map to a finer one.
#[derive(Debug)]
struct Fusion {
    /// Of the finer map; none of the coarsest.
    before: Option<ResidualUnit>,
    after: ResidualUnit,
    project: Layer,
}

impl Fusion {
    fn new(parts: &Parts<'_>, index: usize, features: usize) -> Result<Self, WeightsError> {
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

    /// The fused map at the resolution of `map`. The projection comes before the enlargement, with which it commutes.
    fn forward(&self, map: Map, coarser: Option<Map>, workspace: &Workspace) -> Map {
        let sum = match (&self.before, coarser) {
            (Some(before), Some(coarser)) => {
                let skip = sum(&map, &coarser, workspace);
                before.changed(&map, &skip, workspace)
            }
            _ => map,
        };
        let sum = self.after.changed(&sum, &sum, workspace);
        workspace.layer(&self.project, &sum, None, false)
    }
}

/// Two convolutions, each after a ReLU, whose output is added to the input.
#[derive(Debug)]
struct ResidualUnit {
    first: Layer,
    second: Layer,
}

impl ResidualUnit {
    fn new(parts: &Parts<'_>, name: &str, features: usize) -> Result<Self, WeightsError> {
        let conv = |part: &str| {
            let sizes = [features, features, 3];
            parts.conv(&format!("{name}.{part}"), sizes, ConvSpec::same(1))
        };
        Ok(Self {
            first: conv("conv1")?,
            second: conv("conv2")?,
        })
    }

    /// What the layers make of `map`, added to `skip`.
    fn changed(&self, map: &Map, skip: &Map, workspace: &Workspace) -> Map {
        let map = rectified(map, workspace);
        let map = workspace.layer(&self.first, &map, None, true);
        workspace.layer(&self.second, &map, Some(skip), false)
    }
}

/// A map without its negative values.
fn rectified(map: &Map, workspace: &Workspace) -> Map {
    let mut output = workspace.pool.take(map.height, map.width, map.channels());
    let row = map.width * map.channels();
    let rows = output.values.par_chunks_exact_mut(row);
    rows.zip(map.values.par_chunks_exact(row))
        .each(|(output, values)| {
            for (output, value) in output.iter_mut().zip(values) {
                *output = if *value > 0.0 { *value } else { 0.0 };
            }
        });
    output
}

/// The sum of two maps of one size.
fn sum(one: &Map, other: &Map, workspace: &Workspace) -> Map {
    let mut output = workspace
        .pool
        .copy(&one.values, one.height, one.width, one.channels());
    let row = one.width * one.channels();
    let rows = output.values.par_chunks_exact_mut(row);
    rows.zip(other.values.par_chunks_exact(row))
        .each(|(output, values)| {
            for (output, value) in output.iter_mut().zip(values) {
                *output += value;
            }
        });
    output
}

/// For each of `to` pixels, the two of `from` that it lies between, and the share of the second, where the first and the
/// last pixels of both coincide.
fn axis(from: usize, to: usize) -> Vec<(usize, usize, f32)> {
    let step = from.saturating_sub(1) as f64 / to.saturating_sub(1).max(1) as f64;
    let places = (0..to).map(|i| between(i as f64 * step, from));
    places
        .map(|(low, high, share)| (low, high, share as f32))
        .collect()
}

/// A map enlarged bilinearly to a height and width, with its corner pixels in the corners.
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
