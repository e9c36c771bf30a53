//! The MLP at full resolution, in small pieces.

use super::map::{Map, Pool};
use crate::bilinear::neighbours;
use crate::model::bases::BasisHead;
use crate::model::encoding;
use crate::simd::{Blend, Level, Packed, Scratch, Tail, blend_rows, dot_rows};
use rayon::prelude::*;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

#[derive(Debug)]
pub(super) struct HeadPlan {
    level: Level,
    /// The first layer on features, on codes of columns (with the bias), and on codes of rows.
    features: Packed,
    columns: Packed,
    rows: Packed,
    octaves: usize,
    /// The other hidden layers.
    hidden: Vec<Packed>,
    /// From the last hidden layer to the N base functions.
    last: Packed,
    /// The same as `[width, N]`.
    weights: Vec<f32>,
    grids: Grids,
}

/// Pixels of one piece: whole register tiles of every level, and small enough for caches.
const PIECE: usize = 84;
/// Floats between rows of the first hidden layer: at distances of powers of two they would compete
/// for the same lines of the cache (measured: up to 8 % at 512 channels).
const APART: usize = 16;

impl HeadPlan {
    pub(super) fn new(net: &BasisHead, level: Level) -> Option<Self> {
        let (first, others) = net.hidden.split_first()?;
        let first = first.folded()?;
        let codes = 2 * net.octaves;
        let features = first.depth - 2 * codes;
        let part = |start: usize, depth: usize, bias: &[f32]| {
            let at = |row: usize, column: usize| first.at(start + row, column);
            Packed::new(level, (depth, first.columns), bias, at)
        };
        let hidden = others.iter().map(|layer| {
            let layer = layer.folded()?;
            let size = (layer.depth, layer.columns);
            Some(Packed::new(level, size, &layer.bias, |r, c| layer.at(r, c)))
        });
        let (weights, [width, functions]) = net.last.values();
        let last = |r: usize, c: usize| weights[r * functions + c];
        Some(Self {
            level,
            features: part(0, features, &[]),
            columns: part(features, codes, &first.bias),
            rows: part(features + codes, codes, &[]),
            octaves: net.octaves,
            hidden: hidden.collect::<Option<_>>()?,
            last: Packed::new(level, (width, functions), &[], last),
            weights,
            grids: Grids::default(),
        })
    }

    /// What the features add to the first hidden layer.
    pub(super) fn enter(&self, features: &Map, pool: &Pool) -> Map {
        let columns = self.features.columns();
        let mut map = pool.take(features.height, features.width, columns);
        let tail = Tail::default();
        self.features
            .apply_parallel(&features.values, tail, &mut map.values);
        map
    }

    fn places<'a>(&self, inputs: &'a Map, size: (usize, usize)) -> Places<'a> {
        let features = (inputs.height, inputs.width);
        Places {
            grid: self.grids.get(self, features, size),
            inputs,
        }
    }

    /// Values `[pixels, N + 1]`, the constant first.
    pub(super) fn rows(
        &self,
        inputs: &Map,
        size: (usize, usize),
        pixels: &[u32],
        scratch: &Scratch,
    ) -> Vec<f32> {
        let places = self.places(inputs, size);
        let functions = self.last.columns();
        let mut rows = vec![1.0; pixels.len() * (functions + 1)];
        let pieces = rows.par_chunks_mut(PIECE * (functions + 1));
        pieces
            .zip(pixels.par_chunks(PIECE))
            .for_each(|(rows, pixels)| {
                let own = self.memory(pixels.len());
                scratch.with(own + pixels.len() * functions, |memory| {
                    let (memory, values) = memory.split_at_mut(own);
                    let pixels = pixels.iter().map(|&p| p as usize);
                    let activations = self.activations(&places, pixels, memory);
                    self.last.apply(activations, Tail::default(), values);
                    let targets = rows.chunks_exact_mut(functions + 1);
                    for (row, values) in targets.zip(values.chunks_exact(functions)) {
                        row[1..].copy_from_slice(values);
                    }
                });
            });
        rows
    }

    /// Bases x weights at every pixel: the weights are folded into the last layer, so that the
    /// base functions are never formed.
    pub(super) fn combine(
        &self,
        inputs: &Map,
        size: (usize, usize),
        weights: &[f64],
        scratch: &Scratch,
    ) -> Vec<f32> {
        let places = self.places(inputs, size);
        let functions = self.last.columns().max(1);
        let (constant, weights) = weights.split_first().unwrap_or((&0.0, &[]));
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
        let mut depths = vec![0.0; size.0 * size.1];
        let pieces = depths.par_chunks_mut(PIECE).enumerate();
        pieces.for_each(|(i, depths)| {
            scratch.with(self.memory(depths.len()), |memory| {
                let first = i * PIECE;
                let pixels = first..first + depths.len();
                let activations = self.activations(&places, pixels, memory);
                dot_rows(self.level, activations, &folded, *constant as f32, depths);
            });
        });
        depths
    }

    /// Floats that `activations` needs for a number of pixels.
    fn memory(&self, pixels: usize) -> usize {
        pixels
            * (self.features.columns()
                + APART
                + self.hidden.iter().map(Packed::columns).sum::<usize>())
    }

    /// The last hidden layer `[pixels, width]`.
    fn activations<'a>(
        &self,
        places: &Places<'_>,
        pixels: impl ExactSizeIterator<Item = usize>,
        memory: &'a mut [f32],
    ) -> &'a [f32] {
        let count = pixels.len();
        let columns = self.features.columns();
        let (mut x, mut rest) = memory.split_at_mut(count * (columns + APART));
        let blends = pixels.map(|pixel| places.blend(pixel, columns));
        blend_rows(self.level, blends, columns, x);
        for layer in &self.hidden {
            let (output, others) = rest.split_at_mut(count * layer.columns());
            let tail = Tail {
                skip: None,
                relu: true,
            };
            layer.apply(x, tail, output);
            (x, rest) = (output, others);
        }
        x
    }
}

/// Where the pixels of outputs of one size lie on features of one size, and what their position
/// adds to the first hidden layer.
#[derive(Debug)]
struct Grid {
    size: (usize, usize),
    features: (usize, usize),
    /// Neighbours and weight along each axis.
    rows: Vec<(usize, usize, f32)>,
    columns: Vec<(usize, usize, f32)>,
    row_codes: Vec<f32>,
    column_codes: Vec<f32>,
}

impl Grid {
    fn new(head: &HeadPlan, features: (usize, usize), size: (usize, usize)) -> Self {
        let codes = |length: usize, layer: &Packed| {
            let mut values = vec![0.0; length * layer.columns()];
            let codes = match head.octaves {
                0 => Vec::new(),
                octaves => encoding::axis(length, octaves),
            };
            layer.apply(&codes, Tail::default(), &mut values);
            values
        };
        let axis = |to: usize, from: usize| (0..to).map(|i| neighbours(i, to, from)).collect();
        Self {
            size,
            features,
            rows: axis(size.0, features.0),
            columns: axis(size.1, features.1),
            row_codes: codes(size.0, &head.rows),
            column_codes: codes(size.1, &head.columns),
        }
    }
}

/// The grids of the last few sizes: they depend on nothing else.
#[derive(Debug, Default)]
struct Grids(Mutex<VecDeque<Arc<Grid>>>);

impl Grids {
    const KEPT: usize = 2;

    fn get(&self, head: &HeadPlan, features: (usize, usize), size: (usize, usize)) -> Arc<Grid> {
        let new = || Arc::new(Grid::new(head, features, size));
        // A poisoned lock costs time, nothing else.
        let Ok(mut kept) = self.0.lock() else {
            return new();
        };
        let found = kept
            .iter()
            .find(|g| (g.features, g.size) == (features, size));
        if let Some(grid) = found {
            return grid.clone();
        }
        let grid = new();
        kept.push_front(grid.clone());
        kept.truncate(Self::KEPT);
        grid
    }
}

/// A grid and the features on it.
struct Places<'a> {
    grid: Arc<Grid>,
    inputs: &'a Map,
}

impl Places<'_> {
    /// The first hidden layer, of so many channels, at a pixel.
    fn blend(&self, pixel: usize, channels: usize) -> Blend<'_> {
        let grid = &*self.grid;
        let (y, x) = (pixel / grid.size.1, pixel % grid.size.1);
        let ((top, bottom, v), (left, right, u)) = (grid.rows[y], grid.columns[x]);
        let input = |row: usize, column: usize| {
            &self.inputs.values[(row * self.inputs.width + column) * channels..][..channels]
        };
        Blend {
            parts: [
                (input(top, left), (1.0 - v) * (1.0 - u)),
                (input(top, right), (1.0 - v) * u),
                (input(bottom, left), v * (1.0 - u)),
                (input(bottom, right), v * u),
            ],
            terms: [
                &grid.row_codes[y * channels..][..channels],
                &grid.column_codes[x * channels..][..channels],
            ],
        }
    }
}
