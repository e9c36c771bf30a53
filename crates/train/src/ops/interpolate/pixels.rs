//! Pixels that read a smaller map, as positions on both axes: a list of cells takes eight times the memory.

use super::{BatchCells, BilinearCell};
#[cfg(feature = "wgpu")]
use std::ops::Range;
use std::sync::{Arc, OnceLock};

/// A position along an axis of a map: two neighbours, and the weight of the second. Neither decreases along the axis.
pub type Between = (usize, usize, f32);

/// Pixels of a batch of images that read maps of another size bilinearly.
#[derive(Debug)]
pub struct PixelReads {
    /// Height and width of the maps.
    pub(super) map: [usize; 2],
    /// Position in the map of each row of the images.
    pub(super) rows: Vec<Between>,
    /// Position in the map of each column of the images.
    pub(super) columns: Vec<Between>,
    pub(super) images: usize,
    /// Pixels `y * width + x` of each image, the same number for each; every pixel if absent.
    pub(super) pixels: Option<Vec<Vec<u32>>>,
    cells: OnceLock<BatchCells>,
}

impl PixelReads {
    /// Creates reads of maps of a size (height, width) by every pixel of images with these positions.
    pub fn every(map: [usize; 2], images: usize, [rows, columns]: [Vec<Between>; 2]) -> Self {
        Self {
            map,
            rows,
            columns,
            images,
            pixels: None,
            cells: OnceLock::new(),
        }
    }

    /// Creates reads by some pixels of each image.
    pub fn some(map: [usize; 2], axes: [Vec<Between>; 2], pixels: Vec<Vec<u32>>) -> Self {
        let mut reads = Self::every(map, pixels.len(), axes);
        reads.pixels = Some(pixels);
        reads
    }

    /// Returns the number of pixels of each image.
    #[cfg(feature = "wgpu")]
    pub(super) fn per_image(&self) -> usize {
        let all = self.rows.len() * self.columns.len();
        let lists = self.pixels.as_ref();
        lists.map_or(all, |lists| lists.first().map_or(0, Vec::len))
    }

    /// Returns the same as cells.
    pub(super) fn cells(&self) -> BatchCells {
        let cells = self.cells.get_or_init(|| {
            let width = self.columns.len();
            let of = |y: usize, x: usize| cell(self.map[1], self.rows[y], self.columns[x]);
            let listed = self.pixels.as_ref().map(|lists| {
                let of = |&pixel: &u32| of(pixel as usize / width, pixel as usize % width);
                let lists = lists.iter();
                lists.map(|list| list.iter().map(of).collect()).collect()
            });
            Arc::new(listed.unwrap_or_else(|| {
                let rows = 0..self.rows.len();
                let all = rows.flat_map(|y| (0..width).map(move |x| of(y, x)));
                vec![all.collect(); self.images]
            }))
        });
        cells.clone()
    }

    /// Returns, for each row of the maps and then for each column, the rows or columns of the images that read it.
    #[cfg(feature = "wgpu")]
    pub(super) fn readers(&self) -> Vec<Range<usize>> {
        let of = |length: usize, axis: &[Between]| -> Vec<Range<usize>> {
            let ranges = (0..length).map(|i| {
                let first = axis.partition_point(|&(_, high, _)| high < i);
                let last = axis.partition_point(|&(low, _, _)| low <= i);
                first..last.max(first)
            });
            ranges.collect()
        };
        let mut all = of(self.map[0], &self.rows);
        all.extend(of(self.map[1], &self.columns));
        all
    }
}

/// Returns a cell of a map of width `w`.
pub fn cell(w: usize, (top, bottom, v): Between, (left, right, u): Between) -> BilinearCell {
    let row = |row: usize, column: usize| (row * w + column) as u32;
    BilinearCell {
        rows: [
            row(top, left),
            row(top, right),
            row(bottom, left),
            row(bottom, right),
        ],
        shares: [(1.0 - v) * (1.0 - u), (1.0 - v) * u, v * (1.0 - u), v * u],
    }
}
