//! Dense matrices processed by several threads: the equations of all observations.
//!
//! They are stored column by column; only the lower halves of symmetric matrices are read. Rows and columns are processed in
//! strips, one task each.

use super::strip::{STRIP, Strip};
use lsdc_kernels::cholesky::{MatrixBlock, factorise, solve_rows, subtract_product};
use lsdc_kernels::schedule::{InTasks, join};
use lsdc_kernels::simd::Level;
use rayon::prelude::*;

/// Replaces a matrix of `size` rows by its Cholesky factor L, and `more` further rows E by `E L'^-1`. Both numbers
/// are multiples of [`PAD`](lsdc_kernels::cholesky::PAD). False if the matrix is not positive definite.
pub(super) fn cholesky(
    level: Level,
    (matrix, size): (&mut [f64], usize),
    (extra, more): (&mut [f64], usize),
) -> bool {
    for first in (0..size).step_by(STRIP) {
        let count = STRIP.min(size - first);
        let end = first + count;
        let (own, later) = matrix[first * size..].split_at_mut(count * size);
        let (own_extra, later_extra) = extra[first * more..].split_at_mut(count * more);
        let columns = own.chunks_exact(size);
        let mut block: Vec<f64> = columns.flat_map(|own| &own[first..end]).copied().collect();
        if !factorise(level, &mut block, count, &mut []) {
            return false;
        }
        let part = |values: &[f64], stride: usize, first: usize| {
            let rows = STRIP.min(stride - first);
            let columns = values.chunks_exact(stride);
            let mut values: Vec<f64> = columns
                .flat_map(|column| &column[first..first + rows])
                .copied()
                .collect();
            solve_rows(level, &block, count, &mut values, &mut []);
            Strip {
                first,
                rows,
                values,
            }
        };
        let strips = (end..size).into_par_iter().step_by(STRIP);
        let (below, further): (Vec<Strip>, Vec<Strip>) = join(
            || strips.gather(|start| part(own, size, start)),
            || {
                let strips = (0..more).into_par_iter().step_by(STRIP);
                strips.gather(|start| part(own_extra, more, start))
            },
        );
        // The remaining later columns, while the finished ones are copied back.
        join(
            || {
                let columns = later.par_chunks_mut(STRIP * size);
                let extras = later_extra.par_chunks_mut((STRIP * more).max(1));
                let update = |(i, (columns, extras)): (usize, (&mut [f64], &mut [f64]))| {
                    let right = &below[i];
                    for left in &below[i..] {
                        let target = (&mut columns[left.first..], size);
                        let sizes = [left.rows, right.rows, count];
                        subtract_product(level, target, sizes, left.block(), right.block());
                    }
                    for left in &further {
                        let target = (&mut extras[left.first..], more);
                        let sizes = [left.rows, right.rows, count];
                        subtract_product(level, target, sizes, left.block(), right.block());
                    }
                };
                columns.zip(extras).enumerate().each(update);
            },
            || {
                for (j, column) in own.chunks_exact_mut(size).enumerate() {
                    column[first..end].copy_from_slice(&block[j * count..][..count]);
                    for strip in &below {
                        strip.put_back(j, column);
                    }
                }
                for (j, column) in own_extra.chunks_exact_mut(more.max(1)).enumerate() {
                    for strip in &further {
                        strip.put_back(j, column);
                    }
                }
            },
        );
    }
    true
}

/// Returns the lower half of `matrix matrix'`, for a matrix with this number of rows, a multiple of
/// [`PAD`](lsdc_kernels::cholesky::PAD).
pub(super) fn squared(level: Level, matrix: &[f64], rows: usize) -> Vec<f64> {
    let depth = matrix.len() / rows.max(1);
    let mut square = vec![0.0; rows * rows];
    let parts = square.par_chunks_mut((STRIP * rows).max(1)).enumerate();
    parts.each(|(i, columns)| {
        let first = i * STRIP;
        let factor = MatrixBlock {
            values: &matrix[first..],
            stride: rows,
        };
        let sizes = [rows - first, columns.len() / rows, depth];
        subtract_product(level, (&mut columns[first..], rows), sizes, factor, factor);
        for value in columns {
            *value = -*value;
        }
    });
    square
}

#[cfg(test)]
mod tests {
    use super::*;
    use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
    use faer::{Mat, MatRef, Par, Side};
    use lsdc_rng::Rng;

    #[test]
    fn factors_and_further_rows_agree_with_faer() {
        let mut rng = Rng::stream(0, &["dense"]);
        let mut random = |rows: usize, columns: usize| {
            Mat::from_fn(rows, columns, |_, _| f64::from(rng.normal()))
        };
        for (size, more) in [(8, 8), (64, 0), (72, 16), (200, 136)] {
            let root = random(size, size + 3);
            let matrix = &root * root.transpose();
            let extra = random(more, size);
            let mut lower: Vec<f64> = matrix
                .col_iter()
                .flat_map(|c| c.iter().copied().collect::<Vec<_>>())
                .collect();
            let mut rows: Vec<f64> = extra
                .col_iter()
                .flat_map(|c| c.iter().copied().collect::<Vec<_>>())
                .collect();
            assert!(cholesky(
                Level::here(),
                (&mut lower, size),
                (&mut rows, more)
            ));
            let found = MatRef::from_column_major_slice(&lower, size, size);
            let expected = matrix.llt(Side::Lower).unwrap();
            for j in 0..size {
                for i in j..size {
                    assert!((found[(i, j)] - expected.L()[(i, j)]).abs() < 1e-9);
                }
            }
            let mut white = extra.transpose().to_owned();
            solve_lower_triangular_in_place(expected.L(), white.as_mut(), Par::Seq);
            let rows_found = MatRef::from_column_major_slice(&rows, more, size);
            assert!((rows_found.transpose() - &white).norm_max() < 1e-9);
            let square = squared(Level::here(), &rows, more);
            let expected = white.transpose() * &white;
            for j in 0..more {
                for i in j..more {
                    assert!((square[j * more + i] - expected[(i, j)]).abs() < 1e-8);
                }
            }
        }
        let mut indefinite = vec![1.0; 64];
        assert!(!cholesky(Level::here(), (&mut indefinite, 8), (&mut [], 0)));
    }
}
