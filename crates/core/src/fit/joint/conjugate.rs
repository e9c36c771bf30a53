//! The weights of columns beside an observed field, by conjugate gradients (Hestenes and Stiefel 1952): for so many
//! observations that the moments of all columns would cost more than the solution.

use super::sites::Sample;
use crate::error::FitError;
use crate::field::Observed;
use crate::fit::lstsq::dot;
use faer::linalg::solvers::{Llt, Solve as _};
use faer::{Mat, MatRef, Side};
use rayon::prelude::*;

/// Minimises `(t - P x)' C^-1 (t - P x) + x' D x` over x, where C is the covariance of the targets t of a field, and
/// P the product of the columns and a map from x to their weights.
#[derive(Debug)]
pub(super) struct Normal<'a> {
    field: &'a Observed,
    sample: &'a Sample,
    /// `[columns, unknowns]`.
    map: Mat<f64>,
    /// The diagonal of D.
    penalties: Vec<f64>,
    /// A factor of equations like these: the preconditioner.
    like: Llt<f64>,
}

/// What minimises the sum of squares.
#[derive(Debug)]
pub(super) struct Minimum {
    /// Of the columns.
    pub(super) weights: Vec<f64>,
    pub(super) value: f64,
    /// What the columns leave of the targets.
    pub(super) rest: Vec<f64>,
}

/// Rows that a task multiplies.
const ROWS: usize = 128;

impl<'a> Normal<'a> {
    /// `near` is a matrix like the moments of the columns, `columns' C^-1 columns`.
    ///
    /// # Errors
    /// Values that are not finite.
    pub(super) fn new(
        field: &'a Observed,
        sample: &'a Sample,
        map: Mat<f64>,
        penalties: Vec<f64>,
        near: &Mat<f64>,
    ) -> Result<Self, FitError> {
        let mut like = map.transpose() * near * &map;
        for (i, penalty) in penalties.iter().enumerate() {
            like[(i, i)] += penalty;
        }
        let like = like.llt(Side::Lower).map_err(|_| {
            FitError::Unsolvable("the equations of the weights are not positive definite")
        })?;
        Ok(Self {
            field,
            sample,
            map,
            penalties,
            like,
        })
    }

    /// The weights of the columns at the minimum for targets t. `near` is a vector like `columns' C^-1 t`.
    ///
    /// # Errors
    /// No convergence.
    pub(super) fn minimum(&self, targets: &[f64], near: &[f64]) -> Result<Minimum, FitError> {
        let near = MatRef::from_column_major_slice(near, near.len(), 1);
        let start = self.near((self.map.transpose() * near).col_as_slice(0));
        let x = self.solve(&self.transposed(&self.field.pull(targets)), start)?;
        let model = self.times(&x);
        let rest: Vec<f64> = targets.iter().zip(model).map(|(t, m)| t - m).collect();
        let terms = self.penalties.iter().zip(&x);
        let penalty: f64 = terms.map(|(penalty, x)| penalty * x * x).sum();
        Ok(Minimum {
            weights: self.weights(&x),
            value: dot(&rest, &self.field.pull(&rest)) + penalty,
            rest,
        })
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

    fn weights(&self, x: &[f64]) -> Vec<f64> {
        let x = MatRef::from_column_major_slice(x, x.len(), 1);
        (&self.map * x).col_as_slice(0).to_vec()
    }

    /// `P x`.
    fn times(&self, x: &[f64]) -> Vec<f64> {
        let (weights, stride) = (self.weights(x), self.map.nrows() + 1);
        let parts = self.sample.rows.par_chunks(ROWS * stride);
        let products = |part: &[f64]| -> Vec<f64> {
            let rows = part.chunks_exact(stride);
            rows.map(|row| dot(&row[..stride - 1], &weights)).collect()
        };
        parts.flat_map_iter(products).collect()
    }

    /// `P' values`.
    fn transposed(&self, values: &[f64]) -> Vec<f64> {
        let stride = self.map.nrows() + 1;
        let parts = self.sample.rows.par_chunks(ROWS * stride);
        let sums = parts.zip(values.par_chunks(ROWS)).map(|(part, values)| {
            let mut sums = Mat::<f64>::zeros(stride - 1, 1);
            for (row, value) in part.chunks_exact(stride).zip(values) {
                add(sums.col_as_slice_mut(0), *value, &row[..stride - 1]);
            }
            sums
        });
        // In the same order for any number of threads.
        let sums: Vec<Mat<f64>> = sums.collect();
        let total = sums.iter().fold(Mat::zeros(stride - 1, 1), |a, b| a + b);
        (self.map.transpose() * total).col_as_slice(0).to_vec()
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
