//! The equations of a field as a matrix: each pixel with itself and its four neighbours.

use super::Grid;
use rayon::prelude::*;

/// Which entry of the matrix: of a pixel with itself, or with a later neighbour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Entry {
    Own,
    Right,
    Down,
}

/// A symmetric matrix over the pixels of a grid. Each kind of entry is a map with a border of zeros, so that
/// what lies outside needs no test.
#[derive(Clone, Debug)]
pub(super) struct Stencil {
    stride: usize,
    entries: [Vec<f64>; 3],
}

impl Stencil {
    /// The equations without observations.
    pub(super) fn new(grid: &Grid<'_>) -> Self {
        let (height, width) = (grid.height, grid.width);
        let stride = width + 2;
        let mut entries: [Vec<f64>; 3] = std::array::from_fn(|_| vec![0.0; stride * (height + 2)]);
        let [own, right, down] = &mut entries;
        // Affinities with the pixels after and before.
        let after = |map: &[f64], at: usize, inside: bool| if inside { map[at] } else { 0.0 };
        rows(right, stride, height).for_each(|(y, row)| {
            for (x, value) in row[1..=width].iter_mut().enumerate() {
                *value = -after(grid.right, y * width + x, x + 1 < width);
            }
        });
        rows(down, stride, height).for_each(|(y, row)| {
            for (x, value) in row[1..=width].iter_mut().enumerate() {
                *value = -after(grid.down, y * width + x, y + 1 < height);
            }
        });
        rows(own, stride, height).for_each(|(y, row)| {
            let above = &down[y * stride..];
            let (here, beside) = (&down[(y + 1) * stride..], &right[(y + 1) * stride..]);
            for (x, value) in row[1..=width].iter_mut().enumerate() {
                let [up, low] = [above[x + 1], here[x + 1]];
                *value = grid.level - up - low - beside[x] - beside[x + 1];
            }
        });
        Self { stride, entries }
    }

    /// Where a pixel is in each map.
    pub(super) fn place(&self, x: usize, y: usize) -> usize {
        padded(self.stride, x, y)
    }

    /// From a pixel to another in each map.
    pub(super) fn offset(&self, x: i32, y: i32) -> isize {
        y as isize * self.stride as isize + x as isize
    }

    pub(super) fn map(&self, entry: Entry) -> &[f64] {
        &self.entries[entry as usize]
    }

    pub(super) fn get(&self, entry: Entry, place: usize) -> f64 {
        self.entries[entry as usize][place]
    }
}

/// The rows of a map but for its border.
fn rows(
    map: &mut [f64],
    stride: usize,
    height: usize,
) -> impl IndexedParallelIterator<Item = (usize, &mut [f64])> {
    let rows = map[stride..].par_chunks_exact_mut(stride);
    rows.take(height).enumerate()
}

/// Where a pixel is in a map with a border.
pub(super) fn padded(stride: usize, x: usize, y: usize) -> usize {
    (y + 1) * stride + x + 1
}

/// The neighbours of a pixel: their offsets, which entry joins them, and the offset of the pixel that holds it.
pub(super) const NEIGHBOURS: [([i32; 2], Entry, [i32; 2]); 4] = [
    ([-1, 0], Entry::Right, [-1, 0]),
    ([1, 0], Entry::Right, [0, 0]),
    ([0, -1], Entry::Down, [0, -1]),
    ([0, 1], Entry::Down, [0, 0]),
];
