//! A coarse grid of pixels, for slowly varying quantities.

use crate::bilinear::{between, rescaled};
use rayon::prelude::*;

/// Evenly spaced pixels of a map; all pixels of a small map.
#[derive(Debug)]
pub(super) struct CoarseGrid {
    size: (usize, usize),
    /// Distance between pixels of the coarse grid.
    step: usize,
    columns: Vec<usize>,
    rows: Vec<usize>,
}

impl CoarseGrid {
    /// About `most` of the pixels of a map of some height and width.
    pub(super) fn new(size: (usize, usize), most: usize) -> Self {
        let step = ((size.0 * size.1) as f64 / most as f64)
            .sqrt()
            .ceil()
            .max(1.0) as usize;
        let axis = |length: usize| (step / 2..length.max(step / 2 + 1)).step_by(step);
        let inside = |length: usize| axis(length).map(move |v| v.min(length.saturating_sub(1)));
        Self {
            size,
            step,
            columns: inside(size.1).collect(),
            rows: inside(size.0).collect(),
        }
    }

    /// The pixels (x, y), row by row.
    pub(super) fn pixels(&self) -> impl Iterator<Item = (usize, usize)> {
        let row = |&y: &usize| self.columns.iter().map(move |&x| (x, y));
        self.rows.iter().flat_map(row)
    }

    /// Interpolates non-negative values at these pixels to a map, bilinearly in their logarithms.
    pub(super) fn spread(&self, values: &[f64]) -> Vec<f64> {
        self.spread_over(values, self.size)
    }

    /// Like [`Self::spread`], for a map of another height and width.
    pub(super) fn spread_over(&self, values: &[f64], size: (usize, usize)) -> Vec<f64> {
        // A lower bound, because of the logarithm.
        let least = 1e-12
            * values
                .iter()
                .fold(f64::MIN_POSITIVE, |most: f64, v| most.max(*v));
        let logs: Vec<f64> = values.iter().map(|value| value.max(least).ln()).collect();
        let width = self.columns.len();
        let place = |at: usize, from: usize, to: usize, axis: &[usize]| {
            let offset = rescaled(at as f64, from, to) - axis[0] as f64;
            between(offset / self.step as f64, axis.len())
        };
        let across: Vec<_> = (0..size.1)
            .map(|x| place(x, size.1, self.size.1, &self.columns))
            .collect();
        let mut map = vec![0.0; size.0 * size.1];
        let rows = map.par_chunks_mut(size.1.max(1)).enumerate();
        rows.for_each(|(y, values)| {
            let (top, bottom, down) = place(y, size.0, self.size.0, &self.rows);
            let pairs = logs[top * width..].iter().zip(&logs[bottom * width..]);
            let row: Vec<f64> = pairs
                .take(width)
                .map(|(top, bottom)| top + down * (bottom - top))
                .collect();
            for (value, &(left, right, across)) in values.iter_mut().zip(&across) {
                *value = (row[left] + across * (row[right] - row[left])).exp();
            }
        });
        map
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_that_grow_by_a_factor_are_met_between_the_pixels() {
        let (height, width) = (100, 176);
        let coarse = CoarseGrid::new((height, width), 1100);
        assert_eq!(coarse.pixels().count(), 25 * 44);
        let law = |x: usize, y: usize| (0.02 * x as f64 - 0.05 * y as f64).exp();
        let values: Vec<f64> = coarse.pixels().map(|(x, y)| law(x, y)).collect();
        let map = coarse.spread(&values);
        for (x, y) in [(2, 2), (7, 9), (28, 20), (13, 12)] {
            let found = map[y * width + x];
            assert!((found / law(x, y) - 1.0).abs() < 1e-12, "{found}");
        }
        // Beyond the outermost pixels, these hold.
        assert!((map[0] / law(2, 2) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn small_maps_have_all_pixels() {
        let coarse = CoarseGrid::new((1, 3), 1100);
        assert_eq!(
            coarse.pixels().collect::<Vec<_>>(),
            [(0, 0), (1, 0), (2, 0)]
        );
        let map = coarse.spread(&[2.0, 3.0, 0.5]);
        let pairs = map.iter().zip([2.0, 3.0, 0.5]);
        assert!(pairs.into_iter().all(|(a, b)| (a / b - 1.0).abs() < 1e-12));
        assert!(coarse.spread(&[0.0; 3]).iter().all(|value| *value < 1e-300));
    }
}
