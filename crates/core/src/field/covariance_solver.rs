//! A field observed at some positions, in the form of covariances: kriging with the inverse of the field's
//! equations as covariance function.
//!
//! With K the equations without observations, S the interpolation at these, A their weights and t their targets,
//! the minimum of `y' K y + (S y - t)' A (S y - t)` is `y = K^-1 S' C^-1 t` with `C = S K^-1 S' + A^-1`, where
//! its value is `t' C^-1 t`.

use super::border::Border;
use super::dense::{cholesky, squared};
use super::factor::Factor;
use super::prior::FieldPrior;
use super::strip::STRIP;
use crate::bilinear::InterpolationWeights;
use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::{
    solve_lower_triangular_in_place, solve_upper_triangular_in_place,
};
use faer::prelude::ReborrowMut as _;
use faer::{Accum, Mat, MatMut, MatRef, Par};
use lsdc_kernels::cholesky::PAD;
use lsdc_kernels::schedule::InTasks;
use rayon::prelude::*;
use std::sync::Arc;

/// A field with few observations, based on the factor of the equations without observations.
#[derive(Debug)]
pub struct CovarianceSolver {
    factor: Arc<Factor>,
    border: Border,
    /// The Cholesky factor L of C at the positions of the border, padded, column by column.
    lower: Vec<f64>,
    /// The columns, `[columns, observations]`, in the same order.
    columns: Mat<f64>,
    /// `L^-1 columns`, likewise, padded.
    white: Vec<f64>,
    /// Weights of the observations, in the same order.
    weights: Vec<f64>,
    moments: Mat<f64>,
}

/// Columns solved per task.
const TOGETHER: usize = 33;

impl CovarianceSolver {
    /// Adds observations to a field at positions given by `interpolation`, with `weights` above 0. `columns`,
    /// `[observations, columns]` row by row, are combined to targets. `None` if values are not finite, a weight is not above 0,
    /// or there is no observation.
    ///
    /// # Panics
    /// If lengths do not match or a pixel is outside the grid.
    pub fn new(
        prior: &FieldPrior,
        interpolation: &[InterpolationWeights],
        weights: &[f64],
        columns: &[f64],
    ) -> Option<Self> {
        assert_eq!(weights.len(), interpolation.len(), "weights");
        if interpolation.is_empty() {
            return None;
        }
        let count = columns.len() / interpolation.len();
        assert_eq!(columns.len(), interpolation.len() * count, "columns");
        let factor = prior.0.clone();
        let border = Border::new(&factor, interpolation);
        let n = border.order.len();
        let columns = Mat::from_fn(count, n, |j, i| columns[border.order[i] * count + j]);
        let mut lower = border.covariance(&factor);
        let weights: Vec<f64> = border.order.iter().map(|&i| weights[i]).collect();
        let size = n.next_multiple_of(PAD);
        for (i, column) in lower.chunks_exact_mut(size).enumerate() {
            column[i] += weights.get(i).map_or(1.0, |weight| weight.recip());
        }
        // The columns are appended as further rows of the matrix.
        let more = count.next_multiple_of(PAD);
        let mut white = vec![0.0; size * more];
        for (row, column) in white.chunks_exact_mut(more).zip(columns.col_iter()) {
            let pairs = row.iter_mut().zip(column.iter());
            pairs.for_each(|(to, value)| *to = *value);
        }
        if !cholesky(factor.level, (&mut lower, size), (&mut white, more)) {
            return None;
        }
        let moments = squared(factor.level, &white, more);
        let moments = Mat::from_fn(count, count, |i, j| moments[j * more + i]);
        Some(Self {
            factor,
            border,
            lower,
            columns,
            white,
            weights,
            moments,
        })
    }

    /// `columns^T C^-1 columns` (lower half), where C is the covariance of the targets: for targets `columns x`, the
    /// minimum of the sum over y is `x^T moments x`.
    pub fn moments(&self) -> &Mat<f64> {
        &self.moments
    }

    fn triangle(&self) -> MatRef<'_, f64> {
        triangle(&self.lower, self.weights.len())
    }

    /// `C^-1 targets`, in place.
    fn pull(&self, mut targets: MatMut<'_, f64>) {
        let lower = self.triangle();
        solve_lower_triangular_in_place(lower, targets.as_mut(), Par::Seq);
        solve_upper_triangular_in_place(lower.transpose(), targets, Par::Seq);
    }

    /// The variance of the field at each observation, given the targets: the diagonal of
    /// `A^-1 - A^-1 C^-1 A^-1`.
    pub fn variances(&self) -> Vec<f64> {
        let n = self.weights.len();
        self.variances_of(&(0..n).collect::<Vec<_>>())
    }

    /// The variance of the field at some of the observations, given the targets.
    pub fn variances_of(&self, which: &[usize]) -> Vec<f64> {
        let n = self.weights.len();
        let mut positions = vec![0; n];
        for (position, &i) in self.border.order.iter().enumerate() {
            positions[i] = position;
        }
        let mut requested: Vec<(usize, usize)> =
            which.iter().map(|&i| positions[i]).zip(0..).collect();
        requested.sort_unstable();
        let lower = self.triangle();
        let variances: Vec<Vec<f64>> = requested.par_chunks(TOGETHER).gather(|requested| {
            // The inverse is also a lower triangle.
            let first = requested[0].0;
            let mut inverse = Mat::<f64>::zeros(n - first, requested.len());
            for (j, (position, _)) in requested.iter().enumerate() {
                inverse[(position - first, j)] = 1.0;
            }
            let lower = lower.get(first.., first..);
            solve_lower_triangular_in_place(lower, inverse.as_mut(), Par::Seq);
            let columns = inverse.col_iter().zip(requested);
            columns
                .map(|(column, (position, _))| {
                    let own = self.weights[*position].recip();
                    own * (1.0 - own * column.squared_norm_l2())
                })
                .collect()
        });
        let mut found = vec![0.0; which.len()];
        for ((_, at), variance) in requested.iter().zip(variances.into_iter().flatten()) {
            found[*at] = variance;
        }
        found
    }

    /// The residual of each observation, with each combination t of the columns as targets: `A^-1 C^-1 t`,
    /// `[observations, combinations]` from `[columns, combinations]`.
    pub fn residuals(&self, combinations: MatRef<'_, f64>) -> Mat<f64> {
        let pulls = self.pulls(combinations);
        let mut found = Mat::zeros(pulls.nrows(), pulls.ncols());
        for (i, &at) in self.border.order.iter().enumerate() {
            let own = self.weights[i].recip();
            let pairs = found.row_mut(at).iter_mut().zip(pulls.row(i).iter());
            pairs.for_each(|(residual, pull)| *residual = own * pull);
        }
        found
    }

    /// The field at other positions with each combination of the columns as targets, `[positions, combinations]` from
    /// `[columns, combinations]`.
    ///
    /// # Panics
    /// If a pixel is outside the grid.
    pub fn at(
        &self,
        interpolation: &[InterpolationWeights],
        combinations: MatRef<'_, f64>,
    ) -> Mat<f64> {
        let other = Border::new(&self.factor, interpolation);
        let pulls = self.pulls(combinations);
        // By strips, whose covariances with the observations stay in the cache.
        let strips = (0..interpolation.len().div_ceil(STRIP)).into_par_iter();
        let found: Vec<_> = strips.gather(|strip| {
            let across = self.border.across(&self.factor, &other, strip);
            let size = pulls.nrows().next_multiple_of(PAD);
            let across = MatRef::from_column_major_slice(&across, STRIP, size);
            across.subcols(0, pulls.nrows()) * &pulls
        });
        let mut values = Mat::zeros(interpolation.len(), combinations.ncols());
        for (i, &at) in other.order.iter().enumerate() {
            values
                .row_mut(at)
                .copy_from(-found[i / STRIP].row(i % STRIP));
        }
        values
    }

    /// `C^-1 t` for each combination of the columns, in the order of the border.
    fn pulls(&self, combinations: MatRef<'_, f64>) -> Mat<f64> {
        let (n, count) = (self.weights.len(), self.columns.nrows());
        let stride = count.next_multiple_of(PAD);
        let white = MatRef::from_column_major_slice_with_stride(&self.white, count, n, stride);
        let upper = self.triangle().transpose();
        let mut found = Mat::<f64>::zeros(n, combinations.ncols());
        let parts = column_chunks(found.as_mut()).into_par_iter().enumerate();
        parts.each(|(k, mut part)| {
            let own = combinations.subcols(k * TOGETHER, part.ncols());
            let (accum, one) = (Accum::Replace, 1.0);
            matmul(part.rb_mut(), accum, white.transpose(), own, one, Par::Seq);
            solve_upper_triangular_in_place(upper, part, Par::Seq);
        });
        found
    }

    /// The field for targets `columns x`.
    pub fn extend(&self, x: &[f64]) -> Vec<f64> {
        let pull = self.pull_of(x);
        let mut values = vec![0.0; self.factor.plan.len()];
        self.border.add_to(&self.factor, &pull, &mut values);
        self.factor.backward(values.as_chunks_mut::<1>().0);
        values
    }

    /// The fields for several targets `columns x`, with further right-hand sides at every pixel.
    ///
    /// # Panics
    /// If lengths do not match.
    pub fn extend_all<const B: usize>(
        &self,
        x: [&[f64]; B],
        right: Vec<[f64; B]>,
    ) -> Vec<[f64; B]> {
        let mut values = right;
        self.factor.forward(&mut values);
        for (b, x) in x.into_iter().enumerate() {
            let mut own: Vec<f64> = values.iter().map(|value| value[b]).collect();
            let mut pull = self.pull_of(x);
            let more = self.pull_against(&own);
            pull.iter_mut()
                .zip(more)
                .for_each(|(sum, more)| *sum += more);
            self.border.add_to(&self.factor, &pull, &mut own);
            let pairs = values.iter_mut().zip(own);
            pairs.for_each(|(value, own)| value[b] = own);
        }
        self.factor.backward(&mut values);
        values
    }

    /// The solution of the equations for y, for a right-hand side at every pixel.
    pub fn solve(&self, right: &[f64]) -> Vec<f64> {
        let mut values = right.to_vec();
        self.factor.forward(values.as_chunks_mut::<1>().0);
        let pull = self.pull_against(&values);
        self.border.add_to(&self.factor, &pull, &mut values);
        self.factor.backward(values.as_chunks_mut::<1>().0);
        values
    }

    /// `C^-1 t` for targets `t = columns x`.
    fn pull_of(&self, x: &[f64]) -> Vec<f64> {
        let x = MatRef::from_column_major_slice(x, x.len(), 1);
        let mut pull = self.columns.transpose() * x;
        self.pull(pull.as_mut());
        pull.col_as_slice(0).to_vec()
    }

    /// Returns `C^-1 t` for targets t that cancel the field of a right-hand side, `-S K^-1 right`, from `L^-1 right`.
    fn pull_against(&self, right: &[f64]) -> Vec<f64> {
        let products = self.border.products(&self.factor, right);
        let mut pull = Mat::from_fn(products.len(), 1, |i, _| -products[i]);
        self.pull(pull.as_mut());
        pull.col_as_slice(0).to_vec()
    }
}

impl FieldPrior {
    /// The covariances of the field at some positions, noise not included: `[positions, positions]`.
    ///
    /// # Panics
    /// If a pixel is outside the grid.
    pub fn covariance(&self, interpolation: &[InterpolationWeights]) -> Mat<f64> {
        covariance(&self.0, interpolation)
    }
}

/// `S K^-1 S'`, in the order of `interpolation`.
fn covariance(factor: &Factor, interpolation: &[InterpolationWeights]) -> Mat<f64> {
    let border = Border::new(factor, interpolation);
    let (n, size) = (
        interpolation.len(),
        interpolation.len().next_multiple_of(PAD),
    );
    let lower = border.covariance(factor);
    let mut positions = vec![0; n];
    for (position, &i) in border.order.iter().enumerate() {
        positions[i] = position;
    }
    Mat::from_fn(n, n, |i, j| {
        let (one, other) = (positions[i], positions[j]);
        lower[one.min(other) * size + one.max(other)]
    })
}

/// Returns a matrix of `n` rows without its padding.
fn triangle(values: &[f64], n: usize) -> MatRef<'_, f64> {
    let stride = n.next_multiple_of(PAD);
    MatRef::from_column_major_slice_with_stride(values, n, n, stride)
}

/// Divides a matrix into chunks of columns.
fn column_chunks(matrix: MatMut<'_, f64>) -> Vec<MatMut<'_, f64>> {
    let mut chunks = Vec::new();
    let mut remaining = matrix;
    while remaining.ncols() > 0 {
        let count = TOGETHER.min(remaining.ncols());
        let (own, others) = remaining.split_at_col_mut(count);
        chunks.push(own);
        remaining = others;
    }
    chunks
}
