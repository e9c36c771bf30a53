//! Packed lower triangular matrices.

use faer::Mat;
use std::ops::Range;

/// Some columns of a lower triangular matrix, each from the diagonal on.
#[derive(Clone, Debug)]
pub(super) struct Columns {
    values: Vec<f64>,
    /// The length of the first.
    length: usize,
}

impl Columns {
    /// Columns of a square matrix stored column by column.
    pub(super) fn of(matrix: &[f64], size: usize, columns: Range<usize>) -> Self {
        let (count, length) = (columns.len(), size - columns.start);
        let mut values = Vec::with_capacity(start(length, count));
        for j in columns {
            values.extend_from_slice(&matrix[j * size + j..(j + 1) * size]);
        }
        Self { values, length }
    }

    /// From the diagonal on.
    pub(super) fn column(&self, j: usize) -> &[f64] {
        &self.values[start(self.length, j)..][..self.length - j]
    }

    /// The first `count` columns, from `rows` on, as a matrix; 0 above the diagonal.
    pub(super) fn matrix(&self, rows: Range<usize>, count: usize) -> Mat<f64> {
        Mat::from_fn(rows.len(), count, |i, j| {
            let row = rows.start + i;
            if row < j {
                0.0
            } else {
                self.column(j)[row - j]
            }
        })
    }

    pub(super) fn length(&self) -> usize {
        self.length
    }
}

/// Where column `j` begins if the first column has `length` values.
fn start(length: usize, j: usize) -> usize {
    j * length - j * j.saturating_sub(1) / 2
}
