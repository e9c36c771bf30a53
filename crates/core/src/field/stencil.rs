//! A symmetric matrix with entries between neighbouring pixels of a grid: the equations of a field.

use super::grid::Grid;
use crate::bilinear::InterpolationWeights;
use lsdc_kernels::schedule::InTasks;
use rayon::prelude::*;

/// The neighbours of a pixel with non-zero entries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Connectivity {
    /// Neighbours that share a side, as in the equations without observations.
    Four,
    /// Neighbours that share a side or a corner, as required by observations between pixels.
    Eight,
}

/// Kind of an entry of the matrix: of a pixel with itself, or with a later neighbour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum MatrixEntry {
    Own,
    Right,
    Down,
    DownRight,
    DownLeft,
}

/// The entries of a matrix. Each kind is stored as a map with a border of zeros, so that no bounds are tested.
#[derive(Clone, Debug)]
pub(super) struct Stencil {
    width: usize,
    entries: [Vec<f64>; 5],
}

impl Stencil {
    /// A matrix of zeros.
    pub(super) fn zeros(height: usize, width: usize) -> Self {
        let length = (width + 2) * (height + 2);
        Self {
            width,
            entries: std::array::from_fn(|_| vec![0.0; length]),
        }
    }

    /// The equations without observations.
    pub(super) fn new(grid: &Grid<'_>) -> Self {
        let (height, width) = (grid.height, grid.width);
        let mut matrix = Self::zeros(height, width);
        let stride = width + 2;
        let [own, right, down, ..] = &mut matrix.entries;
        // Affinities with the pixels after and before.
        let after = |map: &[f64], at: usize, inside: bool| if inside { map[at] } else { 0.0 };
        rows(right, stride, height, |y, row| {
            for (x, value) in row[1..=width].iter_mut().enumerate() {
                *value = -after(grid.right, y * width + x, x + 1 < width);
            }
        });
        rows(down, stride, height, |y, row| {
            for (x, value) in row[1..=width].iter_mut().enumerate() {
                *value = -after(grid.down, y * width + x, y + 1 < height);
            }
        });
        rows(own, stride, height, |y, row| {
            let above = &down[y * stride..];
            let (here, beside) = (&down[(y + 1) * stride..], &right[(y + 1) * stride..]);
            for (x, value) in row[1..=width].iter_mut().enumerate() {
                let [up, low] = [above[x + 1], here[x + 1]];
                *value = grid.diagonal_regularisation - up - low - beside[x] - beside[x + 1];
            }
        });
        matrix
    }

    /// Adds `weight s s'` for interpolation weights s.
    pub(super) fn observe(&mut self, interpolation: &InterpolationWeights, weight: f64) {
        for (one, share) in interpolation.iter() {
            for (other, across) in interpolation.iter().filter(|(other, _)| *other >= one) {
                let (entry, place) = self.pair(one, other);
                self.entries[entry as usize][place] += weight * share * across;
            }
        }
    }

    /// Adds `weight` times the interpolation weights s to the diagonal entries of their pixels: the lumped form of
    /// [`Self::observe`], which treats the observation as one of each of these pixels, weighted by its share.
    pub(super) fn observe_lumped(&mut self, interpolation: &InterpolationWeights, weight: f64) {
        for (pixel, share) in interpolation.iter() {
            let (entry, place) = self.pair(pixel, pixel);
            self.entries[entry as usize][place] += weight * share;
        }
    }

    /// `s' M s` for interpolation weights s.
    pub(super) fn at(&self, interpolation: &InterpolationWeights) -> f64 {
        let mut sum = 0.0;
        for (one, share) in interpolation.iter() {
            for (other, across) in interpolation.iter() {
                let (entry, place) = self.pair(one.min(other), one.max(other));
                sum += share * across * self.entries[entry as usize][place];
            }
        }
        sum
    }

    /// The entry of a pixel with itself or a later neighbour.
    fn pair(&self, one: u32, other: u32) -> (MatrixEntry, usize) {
        let place = |pixel: u32| (pixel as usize % self.width, pixel as usize / self.width);
        let ((x, y), (u, v)) = (place(one), place(other));
        let entry = match (u as i64 - x as i64, v - y) {
            (0, 0) => MatrixEntry::Own,
            (1, 0) => MatrixEntry::Right,
            (0, _) => MatrixEntry::Down,
            (1, _) => MatrixEntry::DownRight,
            _ => MatrixEntry::DownLeft,
        };
        (entry, self.place(x, y))
    }

    /// The entries of the pixels with themselves, row by row.
    pub(super) fn diagonal(&self) -> Vec<f64> {
        let own = &self.entries[MatrixEntry::Own as usize];
        let rows = own.chunks_exact(self.width + 2);
        let inside = rows.clone().count().saturating_sub(2);
        let rows = rows.skip(1).take(inside);
        rows.flat_map(|row| &row[1..=self.width]).copied().collect()
    }

    /// Returns the index of a pixel in each map.
    pub(super) fn place(&self, x: usize, y: usize) -> usize {
        padded(self.width, x, y)
    }

    /// Returns the offset between pixels in each map.
    pub(super) fn offset(&self, x: i32, y: i32) -> isize {
        y as isize * (self.width + 2) as isize + x as isize
    }

    pub(super) fn map(&self, entry: MatrixEntry) -> &[f64] {
        &self.entries[entry as usize]
    }

    pub(super) fn map_mut(&mut self, entry: MatrixEntry) -> &mut [f64] {
        &mut self.entries[entry as usize]
    }

    pub(super) fn get(&self, entry: MatrixEntry, place: usize) -> f64 {
        self.entries[entry as usize][place]
    }
}

/// Writes the rows of a map without its border.
fn rows(map: &mut [f64], stride: usize, height: usize, write: impl Fn(usize, &mut [f64]) + Sync) {
    let rows = map[stride..].par_chunks_exact_mut(stride);
    let rows = rows.take(height).enumerate();
    rows.each(|(y, row)| write(y, row));
}

/// Returns the index of a pixel in a map with a border, for a grid of this width.
pub(super) fn padded(width: usize, x: usize, y: usize) -> usize {
    (y + 1) * (width + 2) + x + 1
}

/// A neighbour of a pixel: its offset, the kind of the entry between them, and the offset of the pixel that stores it.
pub(super) type Neighbour = ([i32; 2], MatrixEntry, [i32; 2]);

impl Connectivity {
    /// The neighbours of a pixel.
    pub(super) fn list(self) -> &'static [Neighbour] {
        const ALL: [Neighbour; 8] = [
            ([-1, 0], MatrixEntry::Right, [-1, 0]),
            ([1, 0], MatrixEntry::Right, [0, 0]),
            ([0, -1], MatrixEntry::Down, [0, -1]),
            ([0, 1], MatrixEntry::Down, [0, 0]),
            ([-1, -1], MatrixEntry::DownRight, [-1, -1]),
            ([1, 1], MatrixEntry::DownRight, [0, 0]),
            ([1, -1], MatrixEntry::DownLeft, [1, -1]),
            ([-1, 1], MatrixEntry::DownLeft, [0, 0]),
        ];
        match self {
            Self::Four => &ALL[..4],
            Self::Eight => &ALL,
        }
    }
}
