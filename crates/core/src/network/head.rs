//! The MLP at full resolution, evaluated in small blocks.

use super::config::NetworkConfig;
use super::encoding;
use super::extractor::ExtractorOutput;
use super::grid::{CodeLayers, Grid, Grids, axis_of};
use super::map::{Map, Pool};
use super::tensors::{Linear, Tensors};
use crate::error::WeightsError;
use lsdc_kernels::schedule::InTasks;
use lsdc_kernels::simd::{Blend, Level, Packed, Scratch, Tail, blend_rows, dot_rows};
use rayon::prelude::*;
use std::sync::Arc;

#[derive(Debug)]
pub(super) struct Head {
    level: Level,
    /// The first layer on features, and on codes of positions.
    features: Packed,
    positions: CodeLayers,
    /// The other hidden layers.
    hidden: Vec<Packed>,
    /// From the last hidden layer to the N basis functions.
    last: Packed,
    /// The same weights as `[width, N]`.
    weights: Vec<f32>,
    first: First,
    grids: Grids,
}

/// What the first function is.
#[derive(Debug)]
enum First {
    /// 1 everywhere.
    Constant,
    /// A map, whose logarithm is the last hidden layer times these weights.
    Hidden(Vec<f32>),
    /// A map, whose logarithm the extractor yields.
    ExtractorOutput,
}

/// What a head makes of what an extractor sees in an image.
#[derive(Debug, Default)]
pub(super) struct Inputs {
    /// What the features add to the first hidden layer, at their resolution.
    pub(super) hidden: Map,
    /// The logarithm of the first function there, if the extractor yields it.
    pub(super) logarithm: Option<Map>,
}

/// The logarithm of the first function is kept within this of 0.
pub const STEEPEST: f32 = 4.0;

/// Pixels of one piece: whole register tiles of every level, and small enough for caches.
const PIECE: usize = 84;
/// Places whose positions are encoded at once.
const PLACES: usize = 1 << 13;
/// Floats between rows of the first hidden layer: at distances of powers of two they would compete
/// for the same lines of the cache (measured: up to 8 % at 512 channels).
const APART: usize = 16;

impl Head {
    pub(super) fn new(config: &NetworkConfig, tensors: &Tensors<'_>) -> Result<Self, WeightsError> {
        let level = tensors.level;
        let Some((&width, others)) = config.hidden.split_first() else {
            return Err(WeightsError::Unsupported("its MLP has no hidden layer"));
        };
        let (features, codes) = (config.extractor.features, 2 * config.octaves);
        let depth = features + encoding::channels(config.octaves);
        let first = tensors.linear_norm("head.hidden.0", (depth, width))?;
        let part = |start: usize, depth: usize, bias: &[f32]| {
            let at = |row: usize, column: usize| first.at(start + row, column);
            Packed::new(level, (depth, width), bias, at)
        };
        let mut hidden = Vec::new();
        let mut from = width;
        for (i, &to) in others.iter().enumerate() {
            let layer: Linear =
                tensors.linear_norm(&format!("head.hidden.{}", i + 1), (from, to))?;
            let at = |row: usize, column: usize| layer.at(row, column);
            hidden.push(Packed::new(level, (from, to), &layer.bias, at));
            from = to;
        }
        let functions = config.bases;
        let weights = tensors.values("head.last.weight", &[from, functions])?;
        let first_function = match (config.mean, config.extractor.backbone) {
            (false, _) => First::Constant,
            (true, Some(_)) => First::ExtractorOutput,
            (true, None) => First::Hidden(tensors.values("head.mean.weight", &[from, 1])?.to_vec()),
        };
        let last = |row: usize, column: usize| weights[row * functions + column];
        Ok(Self {
            level,
            features: part(0, features, &[]),
            positions: CodeLayers {
                columns: part(features, codes, &first.bias),
                rows: part(features + codes, codes, &[]),
                octaves: config.octaves,
            },
            hidden,
            last: Packed::new(level, (from, functions), &[], last),
            weights: weights.to_vec(),
            first: first_function,
            grids: Grids::default(),
        })
    }

    pub(super) fn enter(&self, seen: ExtractorOutput, pool: &Pool) -> Inputs {
        let ExtractorOutput {
            features,
            logarithm,
        } = seen;
        let columns = self.features.columns();
        let mut hidden = pool.take(features.height, features.width, columns);
        let tail = Tail::default();
        self.features
            .apply_parallel(&features.values, tail, &mut hidden.values);
        pool.give(features);
        Inputs { hidden, logarithm }
    }

    /// Values `[places, N + 1]`, the constant or the mean first, at positions (u, v) of an image of `size` (height,
    /// width).
    pub(super) fn at(
        &self,
        inputs: &Inputs,
        size: (usize, usize),
        places: &[[f64; 2]],
        scratch: &Scratch,
    ) -> Vec<f32> {
        let functions = self.last.columns() + 1;
        let mut rows = vec![1.0; places.len() * functions];
        let parts = rows.chunks_mut(PLACES * functions);
        for (rows, places) in parts.zip(places.chunks(PLACES)) {
            self.fill(inputs, size, places, scratch, rows);
        }
        rows
    }

    fn fill(
        &self,
        inputs: &Inputs,
        size: (usize, usize),
        places: &[[f64; 2]],
        scratch: &Scratch,
        rows: &mut [f32],
    ) {
        let (functions, channels) = (self.last.columns(), self.features.columns());
        let (grid, cells) = self.cells((inputs.hidden.height, inputs.hidden.width), size, places);
        let pieces = rows.par_chunks_mut(PIECE * (functions + 1));
        pieces.zip(cells.par_chunks(PIECE)).each(|(rows, cells)| {
            let own = self.memory(cells.len());
            scratch.with(own + cells.len() * functions, |memory| {
                let (memory, values) = memory.split_at_mut(own);
                let blends = cells
                    .iter()
                    .map(|&cell| grid.blend(&inputs.hidden, cell, channels));
                let activations = self.activations(blends, memory);
                self.last.apply_sparse(activations, Tail::default(), values);
                let targets = rows.chunks_exact_mut(functions + 1);
                for (row, values) in targets.zip(values.chunks_exact(functions)) {
                    row[1..].copy_from_slice(values);
                }
                let mut first = [0.0; PIECE];
                let first = &mut first[..cells.len()];
                let cells = cells.iter().copied();
                if self.first_function(inputs, &grid, cells, activations, first) {
                    let targets = rows.chunks_exact_mut(functions + 1);
                    targets.zip(first).for_each(|(row, v)| row[0] = *v);
                }
            });
        });
    }

    /// A grid with these places, and the row and column of each.
    fn cells(
        &self,
        features: (usize, usize),
        size: (usize, usize),
        places: &[[f64; 2]],
    ) -> (Arc<Grid>, Vec<(usize, usize)>) {
        let centred = |place: f64, length: usize| {
            place.fract() == 0.0 && (0.0..length as f64).contains(&place)
        };
        let mut all = places.iter();
        if all.all(|&[u, v]| centred(u, size.1) && centred(v, size.0)) {
            // Those of all pixels, which the map needs as well.
            let cells = places.iter().map(|&[u, v]| (v as usize, u as usize));
            return (
                self.grids.get(&self.positions, features, size),
                cells.collect(),
            );
        }
        // Equal coordinates are encoded once.
        let [us, vs] = [0, 1].map(|axis| axis_of(places, axis));
        let grid = Grid::new(&self.positions, features, size, (&vs, &us));
        let index = |axis: &[f64], value: f64| axis.partition_point(|v| *v < value);
        let cells = places.iter().map(|&[u, v]| (index(&vs, v), index(&us, u)));
        (Arc::new(grid), cells.collect())
    }

    /// Bases x weights at every pixel: the weights are folded into the last layer, so that the
    /// basis functions are never formed.
    pub(super) fn combine(
        &self,
        inputs: &Inputs,
        size: (usize, usize),
        weights: &[f64],
        scratch: &Scratch,
    ) -> Vec<f32> {
        let Inputs { hidden, .. } = inputs;
        let grid = self
            .grids
            .get(&self.positions, (hidden.height, hidden.width), size);
        let functions = self.last.columns();
        let (first, weights) = weights.split_first().unwrap_or((&0.0, &[]));
        let folded: Vec<f32> = self
            .weights
            .chunks_exact(functions)
            .map(|row| {
                row.iter()
                    .zip(weights)
                    .map(|(a, w)| f64::from(*a) * w)
                    .sum::<f64>() as f32
            })
            .collect();
        let channels = self.features.columns();
        let mut depths = vec![0.0; size.0 * size.1];
        let rows = depths.par_chunks_mut(size.1.max(1)).enumerate();
        rows.each(|(y, depths)| {
            let entering = hidden.width * channels;
            scratch.with(entering + self.memory(PIECE), |memory| {
                let (row, memory) = memory.split_at_mut(entering);
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
                    if self.first_function(inputs, &grid, cells, activations, map) {
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

    /// The first function at cells of a grid, whose last hidden layer this is; false if it is the constant 1.
    fn first_function(
        &self,
        inputs: &Inputs,
        grid: &Grid,
        cells: impl Iterator<Item = (usize, usize)>,
        activations: &[f32],
        values: &mut [f32],
    ) -> bool {
        match (&self.first, &inputs.logarithm) {
            (First::Hidden(weights), _) => dot_rows(self.level, activations, weights, 0.0, values),
            (First::ExtractorOutput, Some(map)) => {
                let pairs = values.iter_mut().zip(cells);
                pairs.for_each(|(value, cell)| *value = grid.value(map, cell));
            }
            _ => return false,
        }
        for value in values {
            *value = value.clamp(-STEEPEST, STEEPEST).exp();
        }
        true
    }

    /// Floats that `activations` needs for a number of pixels.
    fn memory(&self, pixels: usize) -> usize {
        pixels
            * (self.features.columns()
                + APART
                + self.hidden.iter().map(Packed::columns).sum::<usize>())
    }

    /// The last hidden layer `[blends, width]` from the first.
    fn activations<'a, 'b, const N: usize, const T: usize>(
        &self,
        blends: impl ExactSizeIterator<Item = Blend<'b, N, T>>,
        memory: &'a mut [f32],
    ) -> &'a [f32] {
        let count = blends.len();
        let columns = self.features.columns();
        let (mut x, mut rest) = memory.split_at_mut(count * (columns + APART));
        blend_rows(self.level, blends, columns, true, x);
        for layer in &self.hidden {
            let (output, others) = rest.split_at_mut(count * layer.columns());
            let tail = Tail {
                skip: None,
                relu: true,
            };
            // Whatever is below 0 was cut off.
            layer.apply_sparse(x, tail, output);
            (x, rest) = (output, others);
        }
        x
    }
}
