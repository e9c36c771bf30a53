//! Weighted sums of four rows of a table, as in bilinear interpolation, and their transpose.
//!
//! Sums run in the order of the cells, so results do not depend on the number of threads.

use crate::check_rows;
use crate::schedule::InTasks;
use crate::simd::{Blend, Level, Unset, write_blends, written};
use rayon::prelude::*;

/// Cells per task.
const PIECE: usize = 512;

/// Four rows of a table and their weights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BilinearCell {
    /// Row indices, which may repeat.
    pub rows: [u32; 4],
    /// Weights of the rows.
    pub shares: [f32; 4],
}

/// Returns the weighted sums `[tables, cells, channels]` of rows of `tables [tables, rows, channels]`, for the cells of each
/// table.
///
/// # Panics
/// If `tables` are not rows of `channels` or cannot be divided among the lists of cells, if lists differ in length, or if a
/// cell refers to a row that its table does not have.
pub fn gather(tables: &[f32], channels: usize, cells: &[Vec<BilinearCell>]) -> Vec<f32> {
    check_rows(tables, channels);
    let size = tables.len() / cells.len().max(1);
    assert_eq!(size * cells.len(), tables.len(), "tables");
    let count = cells.first().map_or(0, Vec::len);
    assert!(cells.iter().all(|list| list.len() == count), "cells");
    let per_table = (count * channels).max(1);
    let write = |output: &mut Unset| {
        let outputs = output.par_chunks_mut(per_table).zip(cells).enumerate();
        outputs.for_each(|(i, (output, cells))| {
            gather_one(&tables[i * size..][..size], channels, cells, output);
        });
    };
    // SAFETY: every row of every list is set; if a table lacks a row, this panics and there is no result.
    unsafe { written(cells.len() * count * channels, write) }
}

/// The sums for one table; sets every float.
fn gather_one(table: &[f32], channels: usize, cells: &[BilinearCell], output: &mut Unset) {
    let level = Level::here();
    let row = |row: u32| &table[row as usize * channels..][..channels];
    let outputs = output.par_chunks_mut((PIECE * channels).max(1));
    outputs
        .zip(cells.par_chunks(PIECE))
        .each(|(output, cells)| {
            let blends = cells.iter().map(|cell| Blend::<4, 0> {
                parts: std::array::from_fn(|k| (row(cell.rows[k]), cell.shares[k])),
                terms: [],
            });
            write_blends(level, blends, channels, false, output);
        });
}

/// The transpose of [`gather`]: adds each row of `values [cells, channels]` to the four rows of its cell in
/// `table [rows, channels]`.
///
/// # Panics
/// If `table` is not rows of `channels`, the number of `values` does not match the cells, or a cell refers to a row that
/// `table` does not have.
pub fn scatter(values: &[f32], channels: usize, cells: &[BilinearCell], table: &mut [f32]) {
    check_rows(table, channels);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_that_a_table_lacks_are_refused() {
        let cell = BilinearCell {
            rows: [0, 0, 1, 1],
            shares: [0.5, 0.5, 1.0, 0.0],
        };
        let refused = |tables: Vec<f32>, cells: Vec<Vec<BilinearCell>>| {
            std::panic::catch_unwind(move || gather(&tables, 2, &cells)).is_err()
        };
        let tables = [1.0, 2.0, 10.0, 20.0, 3.0, 4.0, 30.0, 40.0];
        let cells = [vec![cell], vec![cell]];
        assert_eq!(gather(&tables, 2, &cells), [11.0, 22.0, 33.0, 44.0]);
        assert!(refused(vec![1.0, 2.0], vec![vec![cell]]));
        assert!(refused(vec![], vec![vec![cell]]));
        assert!(refused(vec![0.0; 8], vec![vec![cell], vec![]]));
    }
}
