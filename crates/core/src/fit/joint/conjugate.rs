//! The weights of columns beside an observed field, by conjugate gradients (Hestenes and Stiefel 1952): for so many
//! observations that the moments of all columns would cost more than the solution.

use crate::error::FitError;
use crate::field::Observed;
use crate::fit::lstsq::dot;
use faer::linalg::solvers::{Llt, Solve as _};
use faer::{Mat, MatRef, Side};
use rayon::prelude::*;

/// Minimises `(t - P x)' C^-1 (t - P x) + x' D x` over x, where C is the covariance of the targets t of a field.
#[derive(Debug)]
pub(super) struct Normal<'a> {
    field: &'a Observed,
    /// P `[observations, columns]`.
    columns: Mat<f64>,
    /// The diagonal of D.
    penalties: Vec<f64>,
    /// A factor of equations like these: the preconditioner.
    like: Llt<f64>,
}

/// Rows that are multiplied together.
const ROWS: usize = 256;

impl<'a> Normal<'a> {
    /// `like` is a matrix like `P' C^-1 P`.
    ///
    /// # Errors
    /// Values that are not finite.
    pub(super) fn new(
        field: &'a Observed,
        columns: Mat<f64>,
        penalties: Vec<f64>,
        mut like: Mat<f64>,
    ) -> Result<Self, FitError> {
        for (i, penalty) in penalties.iter().enumerate() {
            like[(i, i)] += penalty;
        }
        let like = like.llt(Side::Lower).map_err(|_| {
            FitError::Unsolvable("the equations of the weights are not positive definite")
        })?;
        Ok(Self {
            field,
            columns,
            penalties,
            like,
        })
    }

    /// The minimum for targets t. `right` is a vector like `P' C^-1 t`.
    ///
    /// # Errors
    /// No convergence.
    pub(super) fn minimum(&self, targets: &[f64], right: &[f64]) -> Result<Vec<f64>, FitError> {
        let start = self.near(right);
        self.solve(&self.transposed(&self.field.pull(targets)), start)
    }

    /// Solves the equations of the minimum, `(P' C^-1 P + D) x = right`.
    ///
    /// # Errors
    /// No convergence.
    fn solve(&self, right: &[f64], start: Vec<f64>) -> Result<Vec<f64>, FitError> {
        /// The square of the error that is left, in the norm of the equations and relative to the solution.
        const TOLERANCE: f64 = 1e-8;
        const STEPS: usize = 200;
        let mut x = start;
        let product = self.product(&x);
        let mut rest: Vec<f64> = right.iter().zip(product).map(|(b, p)| b - p).collect();
        let mut direction = self.near(&rest);
        let mut size = dot(&rest, &direction);
        let enough = TOLERANCE * dot(right, &self.near(right));
        for _ in 0..STEPS {
            if size <= enough {
                return Ok(x);
            }
            let product = self.product(&direction);
            let length = size / dot(&direction, &product);
            add(&mut x, length, &direction);
            add(&mut rest, -length, &product);
            let next = self.near(&rest);
            let after = dot(&rest, &next);
            let share = after / size;
            direction
                .iter_mut()
                .zip(next)
                .for_each(|(d, n)| *d = n + share * *d);
            size = after;
        }
        Err(FitError::Unsolvable("conjugate gradients did not converge"))
    }

    /// `(P' C^-1 P + D) x`.
    fn product(&self, x: &[f64]) -> Vec<f64> {
        let mut product = self.transposed(&self.field.pull(&self.times(x)));
        let terms = product.iter_mut().zip(&self.penalties).zip(x);
        terms.for_each(|((sum, penalty), x)| *sum += penalty * x);
        product
    }

    /// `x' D x`.
    pub(super) fn penalty(&self, x: &[f64]) -> f64 {
        let terms = self.penalties.iter().zip(x);
        terms.map(|(penalty, x)| penalty * x * x).sum()
    }

    /// `P x`.
    pub(super) fn times(&self, x: &[f64]) -> Vec<f64> {
        let mut sums = vec![0.0; self.columns.nrows()];
        sums.par_chunks_mut(ROWS)
            .enumerate()
            .for_each(|(part, sums)| {
                for (j, x) in x.iter().enumerate() {
                    let values = &self.columns.col_as_slice(j)[part * ROWS..];
                    sums.iter_mut()
                        .zip(values)
                        .for_each(|(sum, value)| *sum += value * x);
                }
            });
        sums
    }

    /// `P' values`.
    fn transposed(&self, values: &[f64]) -> Vec<f64> {
        let columns = (0..self.columns.ncols()).into_par_iter();
        columns
            .map(|j| dot(self.columns.col_as_slice(j), values))
            .collect()
    }

    fn near(&self, right: &[f64]) -> Vec<f64> {
        let right = MatRef::from_column_major_slice(right, right.len(), 1);
        self.like.solve(right).col_as_slice(0).to_vec()
    }
}

fn add(sums: &mut [f64], factor: f64, values: &[f64]) {
    sums.iter_mut()
        .zip(values)
        .for_each(|(sum, value)| *sum += factor * value);
}
