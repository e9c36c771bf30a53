//! Square blocks of pixels, for quantities of a field that are not needed at every pixel.

use crate::bilinear::InterpolationWeights;
use crate::field::Grid;
use rayon::prelude::*;
use std::ops::Range;

/// A map divided into square blocks; those on the right and at the bottom may be smaller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Blocks {
    /// Height and width of the map.
    size: (usize, usize),
    side: usize,
}

impl Blocks {
    /// Chooses the smallest blocks with which a map of this height and width has about `most` blocks.
    pub(crate) fn new(size: (usize, usize), most: usize) -> Self {
        let pixels = (size.0 * size.1) as f64;
        let side = (pixels / most as f64).sqrt().ceil().max(1.0) as usize;
        Self { size, side }
    }

    /// Returns the numbers of rows and columns of blocks.
    pub(crate) fn counts(self) -> (usize, usize) {
        let along = |length: usize| length.div_ceil(self.side);
        (along(self.size.0), along(self.size.1))
    }

    /// The number of pixels of a whole block.
    pub(crate) fn area(self) -> usize {
        self.side * self.side
    }

    /// The blocks of the pixels that a position is read from.
    pub(super) fn interpolation(
        self,
        interpolation: &InterpolationWeights,
    ) -> InterpolationWeights {
        let (width, across) = (self.size.1, self.counts().1);
        let block = |pixel: u32| {
            let (x, y) = (pixel as usize % width, pixel as usize / width);
            (y / self.side * across + x / self.side) as u32
        };
        interpolation.merged(block)
    }

    /// The pixels of each block, folded row by row.
    pub(crate) fn fold<T: Copy + Sync, A: Copy + Send + Sync>(
        self,
        values: &[T],
        start: A,
        fold: impl Fn(A, T) -> A + Sync,
    ) -> Vec<A> {
        let across = self.counts().1;
        let rows = values.par_chunks((self.size.1 * self.side).max(1));
        let folded = rows.flat_map_iter(|rows| {
            let mut blocks = vec![start; across];
            for row in rows.chunks_exact(self.size.1) {
                for (block, values) in blocks.iter_mut().zip(row.chunks(self.side)) {
                    *block = values.iter().fold(*block, |sum, value| fold(sum, *value));
                }
            }
            blocks
        });
        folded.collect()
    }

    /// Returns the affinities of blocks for which a field of blocks varies like a field of pixels, by the analogy of
    /// conductors: affinities along a row of pixels, from the middle of one block to that of the next, are in series, and rows
    /// are parallel. The first are those with the right neighbour, the second those with the one below.
    pub(super) fn affinities(self, grid: &Grid<'_>) -> (Vec<f64>, Vec<f64>) {
        let (height, width) = self.size;
        let columns = self.counts().1;
        let pixels =
            |first: usize, length: usize| first.min(length)..(first + self.side).min(length);
        let block = |i: usize| {
            let (top, left) = (i / columns * self.side, i % columns * self.side);
            let (rows, row_after) = (pixels(top, height), pixels(top + self.side, height));
            let (own, after) = (pixels(left, width), pixels(left + self.side, width));
            let right = rows.clone().map(|y| {
                let affinity = |x: usize| grid.right[y * width + x];
                in_series(own.clone(), after.clone(), affinity)
            });
            let down = own.clone().map(|x| {
                let affinity = |y: usize| grid.down[y * width + x];
                in_series(rows.clone(), row_after.clone(), affinity)
            });
            (right.sum::<f64>(), down.sum::<f64>())
        };
        let blocks = (0..self.counts().0 * columns).into_par_iter();
        blocks.map(block).unzip()
    }
}

/// The affinity of the middle of a range of pixels with that of the next, which may be empty, from the affinity of each
/// pixel with its successor.
fn in_series(own: Range<usize>, after: Range<usize>, affinity: impl Fn(usize) -> f64) -> f64 {
    if after.is_empty() {
        return 0.0;
    }
    let resistance = |pixels: Range<usize>| pixels.map(|at| affinity(at).recip()).sum::<f64>();
    let (between, last) = (own.end - 1, after.end - 1);
    let inside = resistance(own.start..between) + resistance(after.start..last);
    (affinity(between).recip() + 0.5 * inside).recip()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::PrecisionSolver;
    use crate::fit::Affinities;

    #[test]
    fn blocks_of_equal_affinities_are_like_pixels() {
        let (height, width) = (12, 18);
        let values = vec![3.0; 2 * height * width];
        let pixels = Affinities::new((height, width), &values).unwrap();
        let blocks = Blocks::new((height, width), height * width / 9);
        assert_eq!((blocks.counts(), blocks.area()), ((4, 6), 9));
        let found = pixels.for_blocks(blocks);
        let grid = found.grid(0.0);
        for y in 0..4 {
            for x in 0..6 {
                let expected = [x < 5, y < 3].map(|inside| if inside { 3.0 } else { 0.0 });
                let found = [grid.right[y * 6 + x], grid.down[y * 6 + x]];
                assert!(
                    expected
                        .iter()
                        .zip(found)
                        .all(|(a, b)| (a - b).abs() < 1e-12)
                );
            }
        }
    }

    #[test]
    fn an_edge_that_no_affinity_crosses_stays_one() {
        let (height, width) = (8, 8);
        // Between the second and the third column.
        let value = |i: usize| {
            if i.is_multiple_of(2) && i / 2 % width == 2 {
                0.0
            } else {
                1.0
            }
        };
        let values: Vec<f32> = (0..2 * height * width).map(value).collect();
        let pixels = Affinities::new((height, width), &values).unwrap();
        let found = pixels.for_blocks(Blocks::new((height, width), 16));
        assert_eq!(found.size(), (4, 4));
        for (i, right) in found.grid(0.0).right.iter().enumerate() {
            assert_eq!(*right > 0.0, i % 4 == 2, "{i}");
        }
    }

    /// On a line whose blocks are each uniform, the field of blocks has the variances of the pixels in their middle.
    #[test]
    fn variances_are_those_of_the_pixels() {
        let width = 81;
        // The first of each pair is that with the right neighbour; every third of these leads to the next block.
        let affinity = |i: usize| {
            1.0 + ((i / 6 + 40 * usize::from(i % 6 == 4)) as f32 * 0.7)
                .sin()
                .abs()
        };
        let values: Vec<f32> = (0..2 * width).map(affinity).collect();
        let pixels = Affinities::new((1, width), &values).unwrap();
        let blocks = Blocks {
            size: (1, width),
            side: 3,
        };
        let found = pixels.for_blocks(blocks);
        let at = [4, 40, 76].map(InterpolationWeights::pixel);
        let fine = PrecisionSolver::new(&pixels.grid(0.0), &at, &[50.0; 3]).unwrap();
        let interpolation = at.map(|interpolation| blocks.interpolation(&interpolation));
        let coarse = PrecisionSolver::new(&found.grid(0.0), &interpolation, &[50.0; 3]).unwrap();
        let fine = fine.pixel_variances();
        for (block, variance) in coarse.pixel_variances().iter().enumerate() {
            let expected = fine[3 * block + 1];
            assert!(
                (variance / expected - 1.0).abs() < 1e-9,
                "{block}: {variance} {expected}"
            );
        }
    }

    #[test]
    fn values_are_folded_and_positions_found_by_blocks() {
        let blocks = Blocks {
            size: (3, 5),
            side: 2,
        };
        let values: Vec<f64> = (0..15).map(f64::from).collect();
        let sums = blocks.fold(&values, 0.0, |sum, value| sum + value);
        assert_eq!(sums, [12.0, 20.0, 13.0, 21.0, 25.0, 14.0]);
        let interpolation = InterpolationWeights::new([1.5, 0.5], (3, 5), (3, 5));
        let found: Vec<_> = blocks.interpolation(&interpolation).iter().collect();
        assert_eq!(found, [(0, 0.5), (1, 0.5)]);
    }
}
