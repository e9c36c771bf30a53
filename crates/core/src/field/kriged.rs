//! A field observed at some positions, in the form of covariances: kriging with the inverse of the field's
//! equations as covariance function.
//!
//! With K the equations without observations, S the interpolation at these, A their weights and t their targets,
//! the minimum of `y' K y + (S y - t)' A (S y - t)` is `y = K^-1 S' C^-1 t` with `C = S K^-1 S' + A^-1`, where
//! its value is `t' C^-1 t`. Functions with ridges R on their weights are part of the field: with G their values
//! at the observations, C grows by `G R^-1 G'`, and their weights are `R^-1 G' C^-1 t`.

use super::border::Border;
use super::dense::{cholesky, squared};
use super::factor::Factor;
use super::strip::{STRIP, Strip};
use super::{FieldPrior, Observations};
use crate::bilinear::Taps;
use faer::linalg::triangular_solve::{
    solve_lower_triangular_in_place, solve_upper_triangular_in_place,
};
use faer::{Mat, MatMut, MatRef, Par};
use lsdc_kernels::cholesky::{PAD, solve_rows};
use lsdc_kernels::schedule::InTasks;
use rayon::prelude::*;
use std::sync::Arc;

/// A field with few observations: from the factor of the equations without them.
#[derive(Debug)]
pub struct Kriged {
    factor: Arc<Factor>,
    border: Border,
    /// The Cholesky factor of C at the positions of the border, padded, column by column.
    lower: Vec<f64>,
    /// The columns without those that are part of the field, `[columns, observations]`, in the same order.
    columns: Mat<f64>,
    /// Of the observations, in the same order.
    weights: Vec<f64>,
    moments: Mat<f64>,
    /// `R^-1/2 G'`, by strips of observations.
    functions: Vec<Strip>,
    ridges: Vec<f64>,
}

/// Columns that a task solves for.
const TOGETHER: usize = 33;

impl Kriged {
    /// Adds observations to a field. Columns before the last one may be functions that are part of the field,
    /// with a penalty on the square of the weight of each: its ridge. `None` if values are not finite, a weight is
    /// not above 0, or there is no observation.
    ///
    /// # Panics
    /// If lengths do not match or a pixel is outside the grid.
    pub fn new(prior: &FieldPrior, seen: &Observations<'_>, ridges: &[f64]) -> Option<Self> {
        seen.check();
        assert!(ridges.len() < seen.count, "columns");
        if seen.taps.is_empty() {
            return None;
        }
        let factor = prior.0.clone();
        let border = Border::new(&factor, seen.taps);
        let n = border.order.len();
        let free = seen.count - ridges.len() - 1;
        let row =
            |position: usize| &seen.columns[border.order[position] * seen.count..][..seen.count];
        let columns = Mat::from_fn(free + 1, n, |j, i| {
            row(i)[if j < free { j } else { seen.count - 1 }]
        });
        let functions = strips_of(n, &scales(ridges), |i, j| row(i)[free + j]);
        let mut lower = border.covariance(&factor, &functions);
        let weights: Vec<f64> = border.order.iter().map(|&i| seen.weights[i]).collect();
        let size = n.next_multiple_of(PAD);
        for (i, column) in lower.chunks_exact_mut(size).enumerate() {
            column[i] += weights.get(i).map_or(1.0, |weight| weight.recip());
        }
        // The columns as further rows of the matrix.
        let more = (free + 1).next_multiple_of(PAD);
        let mut white = vec![0.0; size * more];
        for (row, column) in white.chunks_exact_mut(more).zip(columns.col_iter()) {
            let pairs = row.iter_mut().zip(column.iter());
            pairs.for_each(|(to, value)| *to = *value);
        }
        if !cholesky(factor.level, (&mut lower, size), (&mut white, more)) {
            return None;
        }
        let moments = squared(factor.level, &white, more);
        let moments = Mat::from_fn(free + 1, free + 1, |i, j| moments[j * more + i]);
        Some(Self {
            factor,
            border,
            lower,
            columns,
            weights,
            moments,
            functions,
            ridges: ridges.to_vec(),
        })
    }

    /// `columns^T C^-1 columns` (lower half) for the columns that are not part of the field, where C is the
    /// covariance of the targets: for targets `columns x`, the minimum of the sum over y is `x^T moments x`.
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
        let lower = self.triangle();
        let mut inverse = Mat::<f64>::identity(n, n);
        let parts = column_chunks(inverse.as_mut()).into_par_iter();
        parts.enumerate().for_each(|(k, part)| {
            // The inverse is a lower triangle, too.
            let first = k * TOGETHER;
            let (_, part) = part.split_at_row_mut(first);
            let lower = lower.get(first.., first..);
            solve_lower_triangular_in_place(lower, part, Par::Seq);
        });
        let mut variances = vec![0.0; n];
        for (i, &at) in self.border.order.iter().enumerate() {
            let own = self.weights[i].recip();
            variances[at] = own * (1.0 - own * inverse.col(i).squared_norm_l2());
        }
        variances
    }

    /// The field at each observation with each combination t of the columns as targets, which is
    /// `t - A^-1 C^-1 t`: `[observations, combinations]` from `[columns, combinations]`.
    pub fn responses(&self, combinations: MatRef<'_, f64>) -> Mat<f64> {
        let n = self.weights.len();
        let mut found = Mat::<f64>::zeros(n, combinations.ncols());
        let parts = column_chunks(found.as_mut()).into_par_iter();
        parts.enumerate().for_each(|(k, mut part)| {
            let own = combinations.subcols(k * TOGETHER, part.ncols());
            let targets = self.columns.transpose() * own;
            let mut pull = targets.clone();
            self.pull(pull.as_mut());
            for j in 0..part.ncols() {
                for (i, &at) in self.border.order.iter().enumerate() {
                    part[(at, j)] = targets[(i, j)] - pull[(i, j)] / self.weights[i];
                }
            }
        });
        found
    }

    /// The field and the functions that are part of it at other positions, given the targets: their variances, and
    /// their values with each combination of the columns as targets, `[positions, combinations]` from
    /// `[columns, combinations]`. `functions [positions, functions]` are the values of the functions, row by row.
    ///
    /// # Panics
    /// If lengths do not match or a pixel is outside the grid.
    pub fn at(
        &self,
        taps: &[Taps],
        functions: &[f64],
        combinations: MatRef<'_, f64>,
    ) -> (Vec<f64>, Mat<f64>) {
        let count = self.ridges.len();
        assert_eq!(functions.len(), taps.len() * count, "functions");
        let other = Border::new(&self.factor, taps);
        let value = |i: usize, j: usize| functions[other.order[i] * count + j];
        let more = strips_of(taps.len(), &scales(&self.ridges), value);
        let squares = other.squares(&more);
        let n = self.weights.len();
        let mut targets = self.columns.transpose() * combinations;
        let lower = self.triangle();
        let parts = column_chunks(targets.as_mut()).into_par_iter();
        parts.for_each(|part| solve_lower_triangular_in_place(lower, part, Par::Seq));
        // By strips, whose covariances with the observations stay in the cache.
        let strips = (0..taps.len().div_ceil(STRIP)).into_par_iter();
        let found = strips.map(|strip| {
            let (level, size) = (self.factor.level, n.next_multiple_of(PAD));
            let theirs = (&other, &more[..]);
            let mut across = self
                .border
                .across(&self.factor, &self.functions, theirs, strip);
            solve_rows(level, &self.lower, size, &mut across, &mut []);
            let across = MatRef::from_column_major_slice(&across, STRIP, size).subcols(0, n);
            let squares: Vec<f64> = across.row_iter().map(|row| row.squared_norm_l2()).collect();
            (squares, across * &targets)
        });
        let found: Vec<_> = found.collect();
        let mut variances = vec![0.0; taps.len()];
        let mut values = Mat::zeros(taps.len(), combinations.ncols());
        for (i, &at) in other.order.iter().enumerate() {
            let (known, products) = &found[i / STRIP];
            // Rounding may leave less than nothing.
            variances[at] = (squares[i] - known[i % STRIP]).max(0.0);
            values.row_mut(at).copy_from(-products.row(i % STRIP));
        }
        (variances, values)
    }

    /// The field for targets `columns x`, less the functions that are part of it, and the weights of these.
    pub fn extend(&self, x: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let pull = self.pull_of(x);
        let mut values = vec![0.0; self.factor.plan.len()];
        self.border.add_to(&self.factor, &pull, &mut values);
        self.factor.backward(values.as_chunks_mut::<1>().0);
        (values, self.weights_of(&pull))
    }

    /// The same with a further right-hand side at every pixel, which may depend on the weights that `extend` would
    /// return. Returns what it adds to these apart from them.
    pub fn extend_with(
        &self,
        x: &[f64],
        right: impl FnOnce(&[f64]) -> Vec<f64>,
    ) -> (Vec<f64>, [Vec<f64>; 2]) {
        let mut pull = self.pull_of(x);
        let weights = self.weights_of(&pull);
        let mut values = right(&weights);
        let more = self.pull_at(&mut values);
        let added = self.weights_of(&more);
        pull.iter_mut()
            .zip(more)
            .for_each(|(sum, more)| *sum += more);
        self.border.add_to(&self.factor, &pull, &mut values);
        self.factor.backward(values.as_chunks_mut::<1>().0);
        (values, [weights, added])
    }

    /// The solution of the equations for y, for a right-hand side at every pixel.
    pub fn solve(&self, right: &[f64]) -> Vec<f64> {
        let mut values = right.to_vec();
        let pull = self.pull_at(&mut values);
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

    /// `C^-1 t` where t takes a right-hand side's own field away, `-S K^-1 right`; `right` becomes `L^-1 right`.
    fn pull_at(&self, right: &mut [f64]) -> Vec<f64> {
        self.factor.forward(right.as_chunks_mut::<1>().0);
        let products = self.border.products(&self.factor, right);
        let mut pull = Mat::from_fn(products.len(), 1, |i, _| -products[i]);
        self.pull(pull.as_mut());
        pull.col_as_slice(0).to_vec()
    }

    /// The weights of the functions that are part of the field, from `C^-1 t`.
    fn weights_of(&self, pull: &[f64]) -> Vec<f64> {
        let mut weights = vec![0.0; self.ridges.len()];
        for strip in &self.functions {
            strip.add_products(pull, &mut weights);
        }
        let pairs = weights.iter_mut().zip(&self.ridges);
        pairs.for_each(|(weight, ridge)| *weight /= ridge.sqrt());
        weights
    }
}

/// `S K^-1 S'`, in the order of the taps.
pub(super) fn covariance(factor: &Factor, taps: &[Taps]) -> Mat<f64> {
    let border = Border::new(factor, taps);
    let (n, size) = (taps.len(), taps.len().next_multiple_of(PAD));
    let lower = border.covariance(factor, &[]);
    let mut positions = vec![0; n];
    for (position, &i) in border.order.iter().enumerate() {
        positions[i] = position;
    }
    Mat::from_fn(n, n, |i, j| {
        let (one, other) = (positions[i], positions[j]);
        lower[one.min(other) * size + one.max(other)]
    })
}

/// `R^-1/2`.
fn scales(ridges: &[f64]) -> Vec<f64> {
    ridges.iter().map(|ridge| ridge.sqrt().recip()).collect()
}

/// Scaled rows of functions, by strips of `n` observations.
fn strips_of(n: usize, scales: &[f64], at: impl Fn(usize, usize) -> f64 + Sync) -> Vec<Strip> {
    if scales.is_empty() {
        return Vec::new();
    }
    let mut strips = Strip::all(&(0..n), scales.len());
    strips.par_iter_mut().each(|strip| {
        let (first, rows) = (strip.first, strip.rows);
        for (j, (column, scale)) in strip.values.chunks_exact_mut(rows).zip(scales).enumerate() {
            for (value, i) in column.iter_mut().zip(first..n) {
                *value = scale * at(i, j);
            }
        }
    });
    strips
}

/// A matrix of `n` rows without what pads it.
fn triangle(values: &[f64], n: usize) -> MatRef<'_, f64> {
    let stride = n.next_multiple_of(PAD);
    MatRef::from_column_major_slice_with_stride(values, n, n, stride)
}

/// Some columns each.
fn column_chunks(matrix: MatMut<'_, f64>) -> Vec<MatMut<'_, f64>> {
    let mut chunks = Vec::new();
    let mut rest = matrix;
    while rest.ncols() > 0 {
        let count = TOGETHER.min(rest.ncols());
        let (own, others) = rest.split_at_col_mut(count);
        chunks.push(own);
        rest = others;
    }
    chunks
}
