//! Weighted sums of four rows of a table, as bilinear interpolation takes them, and their transpose.
//!
//! Sums run in the order of the cells, so results do not depend on the number of threads.

use crate::simd::{Blend, Level, blend_rows};
use rayon::prelude::*;

/// Cells that are computed as one piece.
const PIECE: usize = 512;

/// Four rows of a table and their shares.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// Rows, which may be the same.
    pub rows: [u32; 4],
    /// The weight of each.
    pub shares: [f32; 4],
}

/// The sum of four rows of `table [rows, channels]` for each cell: `[cells, channels]`.
///
/// # Panics
/// If `table` is not rows of `channels`, or a cell names a row that it lacks.
pub fn gather(table: &[f32], channels: usize, cells: &[Cell]) -> Vec<f32> {
    check(table, channels);
    let level = Level::here();
    let row = |row: u32| &table[row as usize * channels..][..channels];
    let mut output = vec![0.0; cells.len() * channels];
    output
        .par_chunks_mut((PIECE * channels).max(1))
        .zip(cells.par_chunks(PIECE))
        .for_each(|(output, cells)| {
            let blends = cells.iter().map(|cell| Blend::<4, 0> {
                parts: std::array::from_fn(|k| (row(cell.rows[k]), cell.shares[k])),
                terms: [],
            });
            blend_rows(level, blends, channels, false, output);
        });
    output
}

/// The transpose of [`gather`]: adds each row of `values [cells, channels]` to the four rows of its cell in
/// `table [rows, channels]`.
///
/// # Panics
/// If `table` is not rows of `channels`, `values` are not as many as the cells, or a cell names a row that `table`
/// lacks.
pub fn scatter(values: &[f32], channels: usize, cells: &[Cell], table: &mut [f32]) {
    check(table, channels);
    assert_eq!(values.len(), cells.len() * channels, "rows of values");
    Level::here().vectorised(|| {
        for (values, cell) in values.chunks_exact(channels.max(1)).zip(cells) {
            for (&row, &share) in cell.rows.iter().zip(&cell.shares) {
                let row = &mut table[row as usize * channels..][..channels];
                for (sum, value) in row.iter_mut().zip(values) {
                    *sum += share * value;
                }
            }
        }
    });
}

/// Whether `table` is rows of that many channels.
fn check(table: &[f32], channels: usize) {
    assert!(
        table.is_empty() || (channels > 0 && table.len().is_multiple_of(channels)),
        "{} values are not rows of {channels} channels",
        table.len()
    );
}
