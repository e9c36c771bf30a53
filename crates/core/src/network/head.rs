//! The MLP at full resolution, evaluated in small blocks.

use super::config::NetworkConfig;
use super::encoding;
use super::executor::Prepare;
use super::extractor::ExtractedMaps;
use super::grid::{CodeLayers, GridCache, PositionGrid, distinct_coordinates};
use super::map::Map;
use super::tensors::{LinearWeights, Tensors};
use crate::error::WeightsError;
use lsdc_kernels::schedule::InTasks;
use lsdc_kernels::simd::{Blend, Level, Packed, Scratch, Tail, blend_rows, dot_rows};
use rayon::prelude::*;
use std::sync::Arc;

#[derive(Debug)]
pub(super) struct Head {
    level: Level,
    /// The first layer for the features, and for the codes of positions.
    features: Packed,
    positions: CodeLayers,
    /// The other hidden layers.
    hidden: Vec<Packed>,
    /// Layer from the last hidden layer to the N basis functions.
    last: Packed,
    /// The weights of `last` as `[width, N]`.
    weights: Vec<f32>,
    first: FirstFunction,
    grids: GridCache,
}

/// The stored weights of the MLP, with normalisation folded in.
#[derive(Clone, Debug)]
pub struct HeadWeights {
    /// The hidden layers; the inputs of the first are features, codes of columns, and codes of rows.
    pub hidden: Vec<LinearWeights>,
    /// Number of features.
    pub features: usize,
    /// Octaves of the positional encoding, see [`codes`](super::codes).
    pub octaves: usize,
    /// Layer from the last hidden layer to the N basis functions, without bias.
    pub last: LinearWeights,
    /// The first function, which is not counted in N.
    pub first: FirstFunction,
}

impl HeadWeights {
    pub(super) fn new(
        config: &NetworkConfig,
        tensors: &Tensors<'_, impl Prepare>,
    ) -> Result<Self, WeightsError> {
        if config.hidden.is_empty() {
            return Err(WeightsError::Unsupported("its MLP has no hidden layer"));
        }
        let features = config.extractor.features;
        let mut from = features + encoding::channels(config.octaves);
        let mut hidden = Vec::new();
        for (i, &to) in config.hidden.iter().enumerate() {
            hidden.push(tensors.linear_norm(&format!("head.hidden.{i}"), (from, to))?);
            from = to;
        }
        let functions = config.bases;
        let last = tensors.values("head.last.weight", &[from, functions])?;
        let first = match (config.mean, config.extractor.backbone) {
            (false, _) => FirstFunction::Constant,
            (true, Some(_)) => FirstFunction::Extractor,
            (true, None) => {
                let weights = tensors.values("head.mean.weight", &[from, 1])?;
                FirstFunction::Hidden(weights.to_vec())
            }
        };
        Ok(Self {
            hidden,
            features,
            octaves: config.octaves,
            last: LinearWeights {
                columns: functions,
                values: last.to_vec(),
                bias: Vec::new(),
            },
            first,
        })
    }
}

/// The first of the basis functions.
#[derive(Clone, Debug)]
pub enum FirstFunction {
    /// 1 everywhere.
    Constant,
    /// A map; its logarithm is the last hidden layer times these weights.
    Hidden(Vec<f32>),
    /// A map; its logarithm is predicted by the extractor.
    Extractor,
}

/// The output of an extractor after the part of the first hidden layer that commutes with upsampling.
#[derive(Debug)]
pub(super) struct HeadInput {
    /// The first hidden layer for the features alone, at their resolution.
    hidden: Map,
    /// The logarithm of the first function at this resolution, if the extractor predicts it.
    logarithm: Option<Arc<Map>>,
}

/// The logarithm of the first function is limited to this magnitude.
pub const MAX_LOG_DEPTH: f32 = 4.0;

/// Pixels per block: a multiple of the register tile of every level, and small enough for caches.
const PIECE: usize = 84;
/// Positions encoded at once.
const PLACES: usize = 1 << 13;
/// Padding in floats between rows of the first hidden layer: rows at distances of powers of two would compete for the same
/// cache lines (measured: up to 8 % at 512 channels).
const ROW_PADDING: usize = 16;

impl Head {
    pub(super) fn new(level: Level, weights: HeadWeights) -> Result<Self, WeightsError> {
        let HeadWeights {
            hidden,
            features,
            octaves,
            last,
            first: first_function,
        } = weights;
        let Some((first, others)) = hidden.split_first() else {
            return Err(WeightsError::Unsupported("its MLP has no hidden layer"));
        };
        let (codes, depth) = (features + 2 * octaves, first.rows());
        let packed = |layer: &LinearWeights| layer.packed(level, 0..layer.rows(), &layer.bias);
        Ok(Self {
            level,
            features: first.packed(level, 0..features, &[]),
            positions: CodeLayers {
                columns: first.packed(level, features..codes, &first.bias),
                rows: first.packed(level, codes..depth, &[]),
                octaves,
            },
            hidden: others.iter().map(packed).collect(),
            last: packed(&last),
            weights: last.values,
            first: first_function,
            grids: GridCache::default(),
        })
    }

    pub(super) fn input(&self, output: ExtractedMaps<Arc<Map>>) -> HeadInput {
        let ExtractedMaps {
            features,
            logarithm,
        } = output;
        let columns = self.features.columns();
        let pool = &features.pool;
        let mut hidden = pool.take(features.height, features.width, columns);
        let tail = Tail::default();
        self.features
            .apply_parallel(&features.values, tail, &mut hidden.values);
        HeadInput { hidden, logarithm }
    }

    /// Returns values `[places, N + 1]`, first the constant or the map that replaces it, at positions (u, v) of an image of
    /// `size` (height, width).
    pub(super) fn at(
        &self,
        input: &HeadInput,
        size: (usize, usize),
        places: &[[f64; 2]],
        scratch: &Scratch,
    ) -> Vec<f32> {
        let functions = self.last.columns() + 1;
        let mut rows = vec![1.0; places.len() * functions];
        let parts = rows.chunks_mut(PLACES * functions);
        for (rows, places) in parts.zip(places.chunks(PLACES)) {
            self.fill(input, size, places, scratch, rows);
        }
        rows
    }

    fn fill(
        &self,
        input: &HeadInput,
        size: (usize, usize),
        places: &[[f64; 2]],
        scratch: &Scratch,
        rows: &mut [f32],
    ) {
        let (functions, channels) = (self.last.columns(), self.features.columns());
        let (grid, cells) = self.cells((input.hidden.height, input.hidden.width), size, places);
        let pieces = rows.par_chunks_mut(PIECE * (functions + 1));
        pieces.zip(cells.par_chunks(PIECE)).each(|(rows, cells)| {
            let own = self.memory(cells.len());
            scratch.with(own + cells.len() * functions, |memory| {
                let (memory, values) = memory.split_at_mut(own);
                let blends = cells
                    .iter()
                    .map(|&cell| grid.blend(&input.hidden, cell, channels));
                let activations = self.activations(blends, memory);
                self.last.apply_sparse(activations, Tail::default(), values);
                let targets = rows.chunks_exact_mut(functions + 1);
                for (row, values) in targets.zip(values.chunks_exact(functions)) {
                    row[1..].copy_from_slice(values);
                }
                let mut first = [0.0; PIECE];
                let first = &mut first[..cells.len()];
                let cells = cells.iter().copied();
                if self.first_function(input, &grid, cells, activations, first) {
                    let targets = rows.chunks_exact_mut(functions + 1);
                    targets.zip(first).for_each(|(row, v)| row[0] = *v);
                }
            });
        });
    }

    /// Returns a grid with these positions, and the row and column of each.
    fn cells(
        &self,
        features: (usize, usize),
        size: (usize, usize),
        places: &[[f64; 2]],
    ) -> (Arc<PositionGrid>, Vec<(usize, usize)>) {
        let centred = |place: f64, length: usize| {
            place.fract() == 0.0 && (0.0..length as f64).contains(&place)
        };
        let mut all = places.iter();
        if all.all(|&[u, v]| centred(u, size.1) && centred(v, size.0)) {
            // The grid of all pixels, which `combine` also uses.
            let grid = self.grids.get(&self.positions, features, size);
            let cells = places.iter().map(|&[u, v]| (v as usize, u as usize));
            return (grid, cells.collect());
        }
        // Equal coordinates are encoded once.
        let [us, vs] = [0, 1].map(|axis| distinct_coordinates(places, axis));
        let grid = PositionGrid::new(&self.positions, features, size, (&vs, &us));
        let index = |axis: &[f64], value: f64| axis.partition_point(|v| *v < value);
        let cells = places.iter().map(|&[u, v]| (index(&vs, v), index(&us, u)));
        (Arc::new(grid), cells.collect())
    }

    /// Returns the weighted sum of the basis functions at every pixel. The weights are folded into the last layer, so the basis
    /// functions are never computed.
    pub(super) fn combine(
        &self,
        input: &HeadInput,
        size: (usize, usize),
        weights: &[f64],
        scratch: &Scratch,
    ) -> Vec<f32> {
        let hidden = &input.hidden;
        let grid = self
            .grids
            .get(&self.positions, (hidden.height, hidden.width), size);
        let functions = self.last.columns();
        let (first, weights) = weights.split_first().unwrap_or((&0.0, &[]));
        let rows = self.weights.chunks_exact(functions);
        let folded = rows.map(|row| {
            let terms = row.iter().zip(weights).map(|(a, w)| f64::from(*a) * w);
            terms.sum::<f64>() as f32
        });
        let folded: Vec<f32> = folded.collect();
        let channels = self.features.columns();
        let mut depths = vec![0.0; size.0 * size.1];
        let rows = depths.par_chunks_mut(size.1.max(1)).enumerate();
        rows.each(|(y, depths)| {
            let row_length = hidden.width * channels;
            scratch.with(row_length + self.memory(PIECE), |memory| {
                let (row, memory) = memory.split_at_mut(row_length);
                let blends = grid.along_row(hidden, y, channels);
                blend_rows(self.level, blends, channels, false, row);
                for (i, depths) in depths.chunks_mut(PIECE).enumerate() {
                    let columns = i * PIECE..i * PIECE + depths.len();
                    let blends = grid.in_row(row, columns.clone(), channels);
                    let memory = &mut memory[..self.memory(depths.len())];
                    let activations = self.activations(blends, memory);
                    let mut map = [0.0; PIECE];
                    let map = &mut map[..depths.len()];
                    let cells = columns.map(|x| (y, x));
                    if self.first_function(input, &grid, cells, activations, map) {
                        dot_rows(self.level, activations, &folded, 0.0, depths);
                        let pairs = depths.iter_mut().zip(map);
                        pairs.for_each(|(depth, v)| *depth += *first as f32 * *v);
                    } else {
                        dot_rows(self.level, activations, &folded, *first as f32, depths);
                    }
                }
            });
        });
        depths
    }

    /// Computes the first function at cells of a grid from this last hidden layer; false if it is the constant 1.
    fn first_function(
        &self,
        input: &HeadInput,
        grid: &PositionGrid,
        cells: impl Iterator<Item = (usize, usize)>,
        activations: &[f32],
        values: &mut [f32],
    ) -> bool {
        match (&self.first, &input.logarithm) {
            (FirstFunction::Hidden(weights), _) => {
                dot_rows(self.level, activations, weights, 0.0, values);
            }
            (FirstFunction::Extractor, Some(map)) => {
                let pairs = values.iter_mut().zip(cells);
                pairs.for_each(|(value, cell)| *value = grid.value(map, cell));
            }
            _ => return false,
        }
        for value in values {
            *value = value.clamp(-MAX_LOG_DEPTH, MAX_LOG_DEPTH).exp();
        }
        true
    }

    /// Returns the number of floats that `activations` needs for this number of pixels.
    fn memory(&self, pixels: usize) -> usize {
        pixels
            * (self.features.columns()
                + ROW_PADDING
                + self.hidden.iter().map(Packed::columns).sum::<usize>())
    }

    /// Computes the last hidden layer `[blends, width]` from the first one before its ReLU.
    fn activations<'a, 'b, const N: usize, const T: usize>(
        &self,
        blends: impl ExactSizeIterator<Item = Blend<'b, N, T>>,
        memory: &'a mut [f32],
    ) -> &'a [f32] {
        let count = blends.len();
        let columns = self.features.columns();
        let (mut x, mut remaining) = memory.split_at_mut(count * (columns + ROW_PADDING));
        blend_rows(self.level, blends, columns, true, x);
        for layer in &self.hidden {
            let (output, others) = remaining.split_at_mut(count * layer.columns());
            let tail = Tail {
                skip: None,
                relu: true,
            };
            // Many values are 0 after a ReLU.
            layer.apply_sparse(x, tail, output);
            (x, remaining) = (output, others);
        }
        x
    }
}
