//! Strips of rows of a matrix with a row for each observation; each strip is processed by its own task.

use lsdc_kernels::cholesky::{MatrixBlock, PAD};
use std::ops::Range;

/// Number of observations of a strip.
pub(super) const STRIP: usize = 64;

/// The rows of a matrix of some consecutive observations.
#[derive(Debug)]
pub(super) struct Strip {
    /// Position of the first observation, a multiple of [`PAD`].
    pub(super) first: usize,
    pub(super) rows: usize,
    /// `[rows, columns]`, column by column.
    pub(super) values: Vec<f64>,
}

impl Strip {
    pub(super) fn block(&self) -> MatrixBlock<'_> {
        MatrixBlock {
            values: &self.values,
            stride: self.rows,
        }
    }

    /// Adds the product of each column with the values at its positions.
    pub(super) fn add_products(&self, values: &[f64], products: &mut [f64]) {
        let values = self.part(values);
        for (sum, column) in products.iter_mut().zip(self.values.chunks_exact(self.rows)) {
            *sum += dot(&column[..values.len()], values);
        }
    }

    /// The values at its positions.
    fn part<'a>(&self, values: &'a [f64]) -> &'a [f64] {
        &values[self.first..(self.first + self.rows).min(values.len())]
    }

    /// Zeros for the observations at some positions.
    pub(super) fn all(positions: &Range<usize>, columns: usize) -> Vec<Self> {
        if positions.is_empty() {
            return Vec::new();
        }
        let (start, end) = (
            positions.start / PAD * PAD,
            positions.end.next_multiple_of(PAD),
        );
        let firsts = start / STRIP * STRIP..end;
        firsts
            .step_by(STRIP)
            .map(|strip| {
                let first = strip.max(start);
                let rows = end.min(strip + STRIP) - first;
                Strip {
                    first,
                    rows,
                    values: vec![0.0; rows * columns],
                }
            })
            .collect()
    }

    /// Copies a column of the strip into one of the matrix.
    pub(super) fn put_back(&self, j: usize, column: &mut [f64]) {
        column[self.first..][..self.rows]
            .copy_from_slice(&self.values[j * self.rows..][..self.rows]);
    }
}

/// Returns the dot product, summed in lanes for vector units.
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (whole, others) = (a.as_chunks::<8>(), b.as_chunks::<8>());
    let mut lanes = [0.0; 8];
    for (a, b) in whole.0.iter().zip(others.0) {
        for ((sum, a), b) in lanes.iter_mut().zip(a).zip(b) {
            *sum += a * b;
        }
    }
    let rest = whole.1.iter().zip(others.1).map(|(a, b)| a * b);
    lanes.iter().sum::<f64>() + rest.sum::<f64>()
}
