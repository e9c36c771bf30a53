//! Locations of rows and columns of positions on the feature map, and the contribution of the positional encoding to the first
//! hidden layer.

use super::encoding;
use super::map::Map;
use crate::bilinear::neighbours;
use lsdc_kernels::simd::{Blend, Packed, Tail};
use std::collections::VecDeque;
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The first hidden layer applied to the codes of positions.
#[derive(Debug)]
pub(super) struct CodeLayers {
    /// For the codes of columns (with the bias), and for the codes of rows.
    pub(super) columns: Packed,
    pub(super) rows: Packed,
    pub(super) octaves: usize,
}

/// Rows and columns of positions in an image, located on its feature map.
#[derive(Debug)]
pub(super) struct PositionGrid {
    size: (usize, usize),
    features: (usize, usize),
    /// Neighbours and weight along each axis.
    rows: Vec<(usize, usize, f32)>,
    columns: Vec<(usize, usize, f32)>,
    row_codes: Vec<f32>,
    column_codes: Vec<f32>,
}

impl PositionGrid {
    /// Makes the grid of an image of `size` (height, width) at the given rows v and columns u.
    pub(super) fn new(
        layers: &CodeLayers,
        features: (usize, usize),
        size: (usize, usize),
        (rows, columns): (&[f64], &[f64]),
    ) -> Self {
        let codes = |places: &[f64], length: usize, layer: &Packed| {
            let mut values = vec![0.0; places.len() * layer.columns()];
            let codes = encoding::codes(places.iter().copied(), length, layers.octaves);
            layer.apply(&codes, Tail::default(), &mut values);
            values
        };
        let axis = |places: &[f64], from: usize, to: usize| {
            let neighbours = |&place: &f64| {
                let (low, high, share) = neighbours(place, from, to);
                (low, high, share as f32)
            };
            places.iter().map(neighbours).collect()
        };
        Self {
            size,
            features,
            rows: axis(rows, size.0, features.0),
            columns: axis(columns, size.1, features.1),
            row_codes: codes(rows, size.0, &layers.rows),
            column_codes: codes(columns, size.1, &layers.columns),
        }
    }

    /// Returns the first hidden layer at a row and column, before its ReLU.
    pub(super) fn blend<'a>(
        &'a self,
        inputs: &'a Map,
        (y, x): (usize, usize),
        channels: usize,
    ) -> Blend<'a, 4, 2> {
        let ((top, bottom, v), (left, right, u)) = (self.rows[y], self.columns[x]);
        let input = |row: usize, column: usize| {
            &inputs.values[(row * inputs.width + column) * channels..][..channels]
        };
        Blend {
            parts: [
                (input(top, left), (1.0 - v) * (1.0 - u)),
                (input(top, right), (1.0 - v) * u),
                (input(bottom, left), v * (1.0 - u)),
                (input(bottom, right), v * u),
            ],
            terms: [
                &self.row_codes[y * channels..][..channels],
                &self.column_codes[x * channels..][..channels],
            ],
        }
    }

    /// Returns the value of a map of one channel at a row and column.
    #[inline(always)]
    pub(super) fn value(&self, map: &Map, (y, x): (usize, usize)) -> f32 {
        let ((top, bottom, v), (left, right, u)) = (self.rows[y], self.columns[x]);
        let [upper, lower] = [top, bottom].map(|row| {
            let row = &map.values[row * map.width..][..map.width];
            row[left] * (1.0 - u) + row[right] * u
        });
        upper * (1.0 - v) + lower * v
    }

    /// Interpolates the rows of the feature map at a row of the grid.
    pub(super) fn along_row<'a>(
        &'a self,
        inputs: &'a Map,
        y: usize,
        channels: usize,
    ) -> impl ExactSizeIterator<Item = Blend<'a, 2, 1>> {
        let (top, bottom, v) = self.rows[y];
        let [top, bottom] = [top, bottom].map(|row| {
            let length = inputs.width * channels;
            inputs.values[row * length..][..length].chunks_exact(channels)
        });
        let code = &self.row_codes[y * channels..][..channels];
        top.zip(bottom).map(move |(top, bottom)| Blend {
            parts: [(top, 1.0 - v), (bottom, v)],
            terms: [code],
        })
    }

    /// Returns the first hidden layer at some columns of a row, given the interpolated row of the feature map.
    pub(super) fn in_row<'a>(
        &'a self,
        row: &'a [f32],
        columns: Range<usize>,
        channels: usize,
    ) -> impl ExactSizeIterator<Item = Blend<'a, 2, 1>> {
        let column = move |x: usize| &row[x * channels..][..channels];
        columns.map(move |x| {
            let (left, right, u) = self.columns[x];
            Blend {
                parts: [(column(left), 1.0 - u), (column(right), u)],
                terms: [&self.column_codes[x * channels..][..channels]],
            }
        })
    }
}

/// Returns the distinct coordinates of positions along an axis, in ascending order.
pub(super) fn distinct_coordinates(places: &[[f64; 2]], axis: usize) -> Vec<f64> {
    let mut all: Vec<f64> = places.iter().map(|place| place[axis]).collect();
    all.sort_unstable_by(f64::total_cmp);
    all.dedup();
    all
}

/// A cache of the grids of all pixels for the last few sizes; they depend only on the size.
#[derive(Debug, Default)]
pub(super) struct GridCache(Mutex<VecDeque<Arc<PositionGrid>>>);

impl GridCache {
    const CAPACITY: usize = 2;

    pub(super) fn get(
        &self,
        layers: &CodeLayers,
        features: (usize, usize),
        size: (usize, usize),
    ) -> Arc<PositionGrid> {
        let find = |grids: &VecDeque<Arc<PositionGrid>>| {
            let mut grids = grids.iter();
            let same = |grid: &&Arc<PositionGrid>| (grid.features, grid.size) == (features, size);
            grids.find(same).cloned()
        };
        if let Some(grid) = find(&self.lock()) {
            return grid;
        }
        // Computed without the lock, which would block images of other sizes.
        let all = |length: usize| (0..length).map(|i| i as f64).collect::<Vec<_>>();
        let (rows, columns) = (all(size.0), all(size.1));
        let grid = PositionGrid::new(layers, features, size, (&rows, &columns));
        let grid = Arc::new(grid);
        let mut grids = self.lock();
        // Another thread may have inserted the grid in the meantime.
        find(&grids).unwrap_or_else(|| {
            grids.push_front(grid.clone());
            grids.truncate(Self::CAPACITY);
            grid
        })
    }

    fn lock(&self) -> MutexGuard<'_, VecDeque<Arc<PositionGrid>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
