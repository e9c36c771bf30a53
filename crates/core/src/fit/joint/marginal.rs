//! Marginalisation of the weights of the cosine basis from the moments.

use crate::error::FitError;
use crate::fit::lstsq::{Moments, Solution};
use faer::linalg::solvers::{Llt, Solve as _};
use faer::{Mat, Side};

/// Statistics of the eliminated last columns of moments.
pub(super) struct Eliminated {
    /// `W = L L^T`: normal matrix of these columns with their ridges.
    normal: Llt<f64>,
    /// `W^-1 M^T d`: their weights if all other weights were 0.
    alone: Mat<f64>,
    /// `W^-1` times their normal matrix with the other columns `[columns, others]`.
    response: Mat<f64>,
}

impl Moments {
    /// Returns the moments of the columns before the last ones, with the sum of squares with `ridges` minimised over the last
    /// columns; there is one ridge per last column.
    ///
    /// # Errors
    /// Values that are not finite.
    pub(super) fn without_last(self, ridges: &[f64]) -> Result<(Self, Eliminated), FitError> {
        let (last, first) = (ridges.len(), self.rhs.len() - ridges.len());
        let mut normal = self.normal.get(first.., first..).to_owned();
        for (i, ridge) in ridges.iter().enumerate() {
            normal[(i, i)] += ridge;
        }
        let normal = normal.llt(Side::Lower).map_err(|_| {
            FitError::Unsolvable("the equations of cosines are not positive definite")
        })?;
        let across = self.normal.get(first.., ..first);
        let rhs = Mat::from_fn(last, 1, |i, _| self.rhs[first + i]);
        let response = normal.solve(across);
        let alone = normal.solve(&rhs);
        let pull = across.transpose() * &alone;
        let pairs = self.rhs[..first].iter().zip(pull.col_as_slice(0));
        let met: f64 = (0..last).map(|i| rhs[(i, 0)] * alone[(i, 0)]).sum();
        let others = Self {
            normal: self.normal.get(..first, ..first) - across.transpose() * &response,
            rhs: pairs.map(|(rhs, pull)| rhs - pull).collect(),
            square: self.square - met,
            count: self.count,
        };
        let rest = Eliminated {
            normal,
            alone,
            response,
        };
        Ok((others, rest))
    }
}

impl Eliminated {
    /// Returns the solution for all columns from that for the others, x: `alone - response x` with the covariance
    /// `response K K^T response^T + W^-1`.
    pub(super) fn extended(&self, others: &Solution) -> Solution {
        let (first, rank) = (others.weights.len(), others.factor.ncols());
        let last = self.alone.nrows();
        let x = Mat::from_fn(first, 1, |i, _| others.weights[i]);
        let values = &self.alone - &self.response * x;
        let mut factor = Mat::zeros(first + last, rank + last);
        factor
            .submatrix_mut(0, 0, first, rank)
            .copy_from(&others.factor);
        factor
            .submatrix_mut(first, 0, last, rank)
            .copy_from(-(&self.response * &others.factor));
        // W^-1 = L^-T L^-1.
        let mut own = Mat::<f64>::identity(last, last);
        faer::linalg::triangular_solve::solve_upper_triangular_in_place(
            self.normal.L().transpose(),
            own.as_mut(),
            faer::Par::Seq,
        );
        factor.submatrix_mut(first, rank, last, last).copy_from(own);
        Solution {
            weights: [&others.weights[..], values.col_as_slice(0)].concat(),
            rank: others.rank,
            factor,
        }
    }
}

/// Returns the number of directions determined by the points for all columns: the trace of their normal matrix times the
/// covariance of their weights, from the normal matrix of the columns before the last ones, which have these ridges.
pub(super) fn determined(others: &Mat<f64>, ridges: &[f64], all: &Solution) -> f64 {
    let first = others.nrows();
    let (own, last) = all.factor.split_at_row(first);
    let product = others * own;
    let pairs = product.col_iter().zip(own.col_iter());
    let of_others: f64 = pairs.map(|(a, b)| a.transpose() * b).sum();
    let pairs = last.row_iter().zip(ridges);
    let of_last = pairs.map(|(row, ridge)| 1.0 - ridge * row.squared_norm_l2());
    of_others + of_last.sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows of 3 + 2 basis functions of which the last two have ridges, as rows of their own.
    #[test]
    fn weights_that_are_integrated_out_are_those_of_all_columns_together() {
        let value = |i: usize, j: usize| (((i + 1) * (j + 2)) as f64 * 0.71).sin();
        let depth = |i: usize| 2.0 + (i as f64 * 0.9).cos();
        let rows = Mat::from_fn(12, 5, value);
        let depths = Mat::from_fn(12, 1, |i, _| depth(i));
        let ridges = [0.3, 0.8];
        let rhs = rows.transpose() * &depths;
        let moments = Moments {
            normal: rows.transpose() * &rows,
            rhs: rhs.col_as_slice(0).to_vec(),
            square: (0..12).map(|i| depth(i).powi(2)).sum(),
            count: 12,
        };
        let mut all = rows.transpose() * &rows;
        for (i, ridge) in ridges.iter().enumerate() {
            all[(3 + i, 3 + i)] += ridge;
        }
        let all = all.llt(Side::Lower).unwrap();
        let expected = all.solve(&rhs);
        let covariance = all.solve(Mat::<f64>::identity(5, 5));

        let (others, rest) = moments.without_last(&ridges).unwrap();
        let normal = others.normal.llt(Side::Lower).unwrap();
        let x = normal.solve(Mat::from_fn(3, 1, |i, _| others.rhs[i]));
        let inverse = normal.solve(Mat::<f64>::identity(3, 3));
        let solution = Solution {
            weights: x.col_as_slice(0).to_vec(),
            rank: 3,
            factor: inverse.llt(Side::Lower).unwrap().L().to_owned(),
        };
        let found = rest.extended(&solution);
        for i in 0..5 {
            assert!((found.weights[i] - expected[(i, 0)]).abs() < 1e-12);
        }
        let product = &found.factor * found.factor.transpose();
        assert!((&product - covariance).norm_max() < 1e-12);
        let trace: f64 = (0..5)
            .map(|i| (rows.transpose() * &rows * &product)[(i, i)])
            .sum();
        assert!((determined(&others.normal, &ridges, &found) - trace).abs() < 1e-12);
        // The least sum of squares is the same.
        let least = |square: f64, rhs: &[f64], x: &[f64]| {
            square - rhs.iter().zip(x).map(|(r, x)| r * x).sum::<f64>()
        };
        let square = (0..12).map(|i| depth(i).powi(2)).sum();
        let together = least(square, rhs.col_as_slice(0), expected.col_as_slice(0));
        let apart = least(others.square, &others.rhs, &solution.weights);
        assert!((together - apart).abs() < 1e-12);
    }
}
