//! One least-squares problem in f64: solution and closed-form adjoint.

#[cfg(test)]
mod tests;

use crate::error::FitError;
use faer::linalg::matmul::triangular::{BlockStructure, matmul};
use faer::linalg::solvers::{Llt, Solve as _};
use faer::linalg::triangular_inverse::invert_lower_triangular;
use faer::{Accum, Mat, MatRef, Par, Side};
use rayon::prelude::*;

/// The solver of a problem.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Solver {
    /// Truncated SVD: directions whose singular values are at most this fraction of the largest are
    /// truncated; the result is the minimum-norm solution in the rest (paper Algorithm 1).
    Truncated(f64),
    /// Normal equations plus a ridge on the diagonal, as a fraction of their mean diagonal.
    Ridge(f64),
}

/// A weighted least-squares problem: rows are scaled by the square root of their weights; rows of weight 0
/// are left out.
#[derive(Clone, Debug)]
pub struct Problem {
    rows: Vec<usize>,
    roots: Vec<f64>,
    /// Basis functions, then the depth, of each row.
    values: Vec<f64>,
    columns: usize,
    pub(super) depths: Vec<f64>,
}

/// The sufficient statistics of a problem. Those of two sets of points can be added.
#[derive(Clone, Debug)]
pub struct Moments {
    /// `M^T M`, both halves.
    pub normal: Mat<f64>,
    /// `M^T d`.
    pub rhs: Vec<f64>,
    /// `d^T d`.
    pub square: f64,
    /// The number of rows with a nonzero weight.
    pub count: usize,
}

/// The weights of the basis functions, and quantities derived from them in closed form.
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    /// One weight per basis function.
    pub weights: Vec<f64>,
    /// The number of directions that were kept.
    pub rank: usize,
    /// K `[k, r]`: for points whose noise has variance 1, the covariance of the weights is K K^T.
    pub factor: Mat<f64>,
}

impl Solution {
    /// `|K^T f|^2` for each row f of `bases`: the variance of a fitted value, for points whose noise has
    /// variance 1.
    pub fn spreads<T: Copy + Into<f64>>(&self, bases: &[T]) -> Vec<f64> {
        let k = self.weights.len().max(1);
        let rows = Mat::from_fn(bases.len() / k, k, |i, j| bases[i * k + j].into());
        let product = rows * &self.factor;
        (0..product.nrows())
            .map(|i| product.row(i).squared_norm_l2())
            .collect()
    }

    /// The leverage of each row that was fitted with a weight: the influence of its depth on its own fitted
    /// value, from 0 (also for rows of weight 0) to 1. A residual divided by 1 - leverage is the residual
    /// that the row would have if it were left out (Allen 1974).
    pub fn leverages<T: Copy + Into<f64>>(&self, bases: &[T], weights: &[f64]) -> Vec<f64> {
        let spreads = self.spreads(bases).into_iter().zip(weights);
        // Rounding may slightly exceed the range.
        spreads.map(|(s, w)| (s * w).clamp(0.0, 1.0)).collect()
    }
}

/// The kept part of a singular value decomposition: `matrix = u diag(s) v^T`.
pub(super) struct TruncatedSvd {
    pub(super) u: Mat<f64>,
    pub(super) s: Vec<f64>,
    pub(super) v: Mat<f64>,
}

impl Problem {
    /// `bases` holds one row per depth; all lengths must agree.
    pub fn new<T: Copy + Into<f64>>(bases: &[T], depths: &[f64], weights: &[f64]) -> Self {
        let columns = bases.len() / depths.len().max(1);
        let rows: Vec<usize> = (0..depths.len()).filter(|&i| weights[i] > 0.0).collect();
        let roots: Vec<f64> = rows.iter().map(|&i| weights[i].sqrt()).collect();
        let mut values = Vec::with_capacity(rows.len() * (columns + 1));
        for (&i, root) in rows.iter().zip(&roots) {
            let row = &bases[i * columns..][..columns];
            values.extend(row.iter().map(|&v| root * v.into()));
            values.push(root * depths[i]);
        }
        let depths = values.chunks_exact(columns + 1).map(|row| row[columns]);
        Self {
            rows,
            roots,
            depths: depths.collect(),
            values,
            columns,
        }
    }

    fn matrix(&self) -> MatRef<'_, f64> {
        let (columns, row) = (self.columns, self.columns + 1);
        MatRef::from_row_major_slice_with_stride(&self.values, self.rows.len(), columns, row)
    }

    fn scaled_rows(&self) -> impl Iterator<Item = &[f64]> {
        let rows = self.values.chunks_exact(self.columns + 1);
        rows.map(|row| &row[..self.columns])
    }

    /// `M x`.
    fn times(&self, x: &[f64]) -> Vec<f64> {
        self.scaled_rows().map(|row| dot(row, x)).collect()
    }

    /// `M^T x`.
    fn transposed_times(&self, x: &[f64]) -> Vec<f64> {
        let mut sum = vec![0.0; self.columns];
        for (row, x) in self.scaled_rows().zip(x) {
            sum.iter_mut().zip(row).for_each(|(s, v)| *s += v * x);
        }
        sum
    }

    /// Solves the problem.
    ///
    /// # Errors
    /// Values that are not finite.
    pub fn solve(&self, solver: Solver) -> Result<Solution, FitError> {
        let columns = self.columns;
        if self.rows.is_empty() {
            return Ok(Solution {
                weights: vec![0.0; columns],
                rank: 0,
                factor: Mat::zeros(columns, 0),
            });
        }
        match solver {
            Solver::Truncated(rcond) => {
                if let Some(solution) = self.full_rank(rcond) {
                    return Ok(solution);
                }
                let kept = self.decompose(rcond)?;
                let inner = divide(transposed_times(kept.u.as_ref(), &self.depths), &kept.s);
                Ok(Solution {
                    weights: times(kept.v.as_ref(), &inner),
                    rank: kept.s.len(),
                    factor: Mat::from_fn(columns, kept.s.len(), |i, j| kept.v[(i, j)] / kept.s[j]),
                })
            }
            Solver::Ridge(share) => {
                let (factor, rhs) = self.ridge(share)?;
                Ok(Solution {
                    weights: solve(&factor, &rhs),
                    rank: columns,
                    factor: inverse_factor(&factor),
                })
            }
        }
    }

    /// The solution by the normal equations, if they show that nothing has to be truncated and are well
    /// enough conditioned to be trusted: several times faster than a decomposition.
    pub(super) fn full_rank(&self, rcond: f64) -> Option<Solution> {
        /// Normal equations square the condition of the matrix, so that f64 leaves 7 digits; a
        /// step of refinement wins back the rest.
        const WORST: f64 = 3e4;
        let columns = self.columns;
        if self.rows.len() < columns {
            return None;
        }
        let (normal, rhs) = self.normal();
        let largest = (0..columns).map(|i| normal[(i, i)]).sum::<f64>().sqrt();
        let factor = normal.llt(Side::Lower).ok()?;
        let inverse = inverse_factor(&factor);
        // Frobenius norms are bounds: largest >= s[0] and 1 / smallest >= 1 / s[last].
        let condition = largest * inverse.norm_l2();
        if condition.is_nan() || condition >= WORST.min(1.0 / rcond) {
            return None;
        }
        let mut weights = solve(&factor, &rhs);
        let residual = subtract(&self.depths, &self.times(&weights));
        let step = solve(&factor, &self.transposed_times(&residual));
        weights.iter_mut().zip(step).for_each(|(w, s)| *w += s);
        Some(Solution {
            weights,
            rank: columns,
            factor: inverse,
        })
    }

    /// The sufficient statistics of the problem.
    pub fn moments(&self) -> Moments {
        let (half, rhs) = self.normal();
        let columns = self.columns;
        Moments {
            normal: Mat::from_fn(columns, columns, |i, j| half[(i.max(j), i.min(j))]),
            rhs,
            square: dot(&self.depths, &self.depths),
            count: self.rows.len(),
        }
    }

    /// The lower half of `M^T M`, and `M^T d`.
    fn normal(&self) -> (Mat<f64>, Vec<f64>) {
        /// Rows per task; independent of the number of threads, so that the sum is, too.
        const ROWS: usize = 256;
        let row = self.columns + 1;
        let parts: Vec<Mat<f64>> = self
            .values
            .par_chunks(ROWS * row)
            .map(|values| {
                let rows = MatRef::from_row_major_slice(values, values.len() / row, row);
                let mut product = Mat::zeros(row, row);
                matmul(
                    product.as_mut(),
                    BlockStructure::TriangularLower,
                    Accum::Replace,
                    rows.transpose(),
                    BlockStructure::Rectangular,
                    rows,
                    BlockStructure::Rectangular,
                    1.0,
                    Par::Seq,
                );
                product
            })
            .collect();
        let total = parts.into_iter().reduce(|sum, part| sum + part);
        let total = total.unwrap_or_else(|| Mat::zeros(row, row));
        let rhs = (0..self.columns).map(|j| total[(self.columns, j)]);
        let normal = total.submatrix(0, 0, self.columns, self.columns);
        (normal.to_owned(), rhs.collect())
    }

    /// The gradients with respect to `bases` (row by row) and `depths`, as given to `new` for `count` rows,
    /// from the gradient `grad` of the solution. Rows of weight 0 get exactly 0.
    ///
    /// # Errors
    /// Values that are not finite.
    pub fn backward(
        &self,
        grad: &[f64],
        solver: Solver,
        count: usize,
    ) -> Result<(Vec<f64>, Vec<f64>), FitError> {
        let columns = self.columns;
        let (mut bases, mut depths) = (vec![0.0; count * columns], vec![0.0; count]);
        if self.rows.is_empty() {
            return Ok((bases, depths));
        }
        let adjoint = match solver {
            Solver::Truncated(rcond) => self.truncated_adjoint(grad, rcond)?,
            Solver::Ridge(share) => self.ridge_adjoint(grad, share)?,
        };
        for (i, (&row, root)) in self.rows.iter().zip(&self.roots).enumerate() {
            depths[row] = root * adjoint.depths[i];
            for j in 0..columns {
                bases[row * columns + j] = root * adjoint.bases[(i, j)];
            }
        }
        Ok((bases, depths))
    }

    /// The adjoint of the truncated solution.
    ///
    /// Inside the kept and discarded directions it is the derivative of a spectral function with
    /// f(s) = 1/s on the kept set and 0 elsewhere (Daleckii and Krein 1965); with nothing
    /// discarded it is the adjoint of the pseudo-inverse (Golub and Pereyra 1973).
    fn truncated_adjoint(&self, grad: &[f64], rcond: f64) -> Result<LstsqAdjoint, FitError> {
        let all = self.decompose(-1.0)?;
        let (s, limit) = (&all.s, rcond * all.s[0]);
        let rank = s.iter().filter(|&&s| s > limit).count();
        let c = transposed_times(all.u.as_ref(), &self.depths);
        let p = transposed_times(all.v.as_ref(), grad);
        let total = s.len();
        let mut inner = Mat::<f64>::zeros(total, total);
        for a in 0..rank {
            for b in 0..rank {
                inner[(a, b)] = -p[a] * c[b] / (s[a] * s[b]);
            }
            for b in rank..total {
                let even = 1.0 / (s[a] * s[a] - s[b] * s[b]);
                let odd = even * s[b] / s[a];
                inner[(a, b)] = odd * p[a] * c[b] + even * p[b] * c[a];
                inner[(b, a)] = even * p[a] * c[b] + odd * p[b] * c[a];
            }
        }
        let mut bases = &all.u * &inner * all.v.transpose();
        // The parts of a change of the matrix outside its column and row spaces.
        let outside_u = subtract(&self.depths, &times(all.u.as_ref(), &c));
        let outside_v = subtract(grad, &times(all.v.as_ref(), &p));
        let over = |x: &[f64], power: i32| -> Vec<f64> {
            let scaled = x.iter().zip(s).take(rank).map(|(x, s)| x / s.powi(power));
            scaled.chain(std::iter::repeat(0.0)).take(total).collect()
        };
        let v = times(all.v.as_ref(), &over(&p, 2));
        let u = times(all.u.as_ref(), &over(&c, 2));
        for j in 0..bases.ncols() {
            for i in 0..bases.nrows() {
                bases[(i, j)] += outside_u[i] * v[j] + u[i] * outside_v[j];
            }
        }
        Ok(LstsqAdjoint {
            bases,
            depths: times(all.u.as_ref(), &over(&p, 1)),
        })
    }

    /// The adjoint of `x = A^-1 M^T d` with `A = M^T M + share trace(M^T M) / k I`.
    fn ridge_adjoint(&self, grad: &[f64], share: f64) -> Result<LstsqAdjoint, FitError> {
        let matrix = self.matrix();
        let (factor, rhs) = self.ridge(share)?;
        let (x, v) = (solve(&factor, &rhs), solve(&factor, grad));
        let depths = self.times(&v);
        let residual = subtract(&self.depths, &self.times(&x));
        let shrink = 2.0 * share / matrix.ncols() as f64 * dot(&v, &x);
        let bases = Mat::from_fn(matrix.nrows(), matrix.ncols(), |i, j| {
            residual[i] * v[j] - depths[i] * x[j] - shrink * matrix[(i, j)]
        });
        Ok(LstsqAdjoint { bases, depths })
    }

    /// The Cholesky factor of the regularised normal equations, and their right side.
    fn ridge(&self, share: f64) -> Result<(Llt<f64>, Vec<f64>), FitError> {
        let columns = self.columns;
        let (mut normal, rhs) = self.normal();
        let trace: f64 = (0..columns).map(|i| normal[(i, i)]).sum();
        // Where all basis functions are zero, so are their weights.
        let shift = if trace > 0.0 {
            share * trace / columns as f64
        } else {
            1.0
        };
        for i in 0..columns {
            normal[(i, i)] += shift;
        }
        let factor = normal.llt(Side::Lower).map_err(|_| {
            FitError::Unsolvable(
                "the normal equations are not positive definite; raise `fit.ridge`",
            )
        })?;
        Ok((factor, rhs))
    }

    /// The singular directions with `s > rcond * s[0]`; a QR step first makes tall problems cheap.
    pub(super) fn decompose(&self, rcond: f64) -> Result<TruncatedSvd, FitError> {
        let matrix = self.matrix();
        let failed = |_| FitError::Unsolvable("the singular value decomposition did not converge");
        let tall = matrix.nrows() > matrix.ncols();
        let (u, s, v) = if tall {
            let qr = matrix.qr();
            let svd = qr.thin_R().thin_svd().map_err(failed)?;
            let u = qr.compute_thin_Q() * svd.U();
            (u, singular_values(&svd), svd.V().to_owned())
        } else {
            let svd = matrix.thin_svd().map_err(failed)?;
            (
                svd.U().to_owned(),
                singular_values(&svd),
                svd.V().to_owned(),
            )
        };
        let limit = rcond * s.first().copied().unwrap_or(0.0);
        let rank = s.iter().filter(|&&s| s > limit).count();
        Ok(TruncatedSvd {
            u: u.subcols(0, rank).to_owned(),
            v: v.subcols(0, rank).to_owned(),
            s: s[..rank].to_vec(),
        })
    }
}

/// Gradients with respect to the scaled rows.
struct LstsqAdjoint {
    bases: Mat<f64>,
    depths: Vec<f64>,
}

/// K with K K^T the inverse of what was factored.
fn inverse_factor(factor: &Llt<f64>) -> Mat<f64> {
    let size = factor.L().nrows();
    let mut inverse = Mat::zeros(size, size);
    invert_lower_triangular(inverse.as_mut(), factor.L(), Par::Seq);
    inverse.transpose().to_owned()
}

fn solve(factor: &Llt<f64>, b: &[f64]) -> Vec<f64> {
    let b = Mat::from_fn(b.len(), 1, |i, _| b[i]);
    let x = factor.solve(&b);
    (0..x.nrows()).map(|i| x[(i, 0)]).collect()
}

fn singular_values(svd: &faer::linalg::solvers::Svd<f64>) -> Vec<f64> {
    svd.S().column_vector().iter().copied().collect()
}

pub(super) fn times(a: MatRef<'_, f64>, x: &[f64]) -> Vec<f64> {
    let mut y = vec![0.0; a.nrows()];
    for (j, x) in x.iter().enumerate() {
        for (i, y) in y.iter_mut().enumerate() {
            *y += a[(i, j)] * x;
        }
    }
    y
}

pub(super) fn transposed_times(a: MatRef<'_, f64>, x: &[f64]) -> Vec<f64> {
    (0..a.ncols())
        .map(|j| x.iter().enumerate().map(|(i, x)| a[(i, j)] * x).sum())
        .collect()
}

pub(super) fn divide(x: Vec<f64>, s: &[f64]) -> Vec<f64> {
    x.into_iter().zip(s).map(|(x, s)| x / s).collect()
}

fn subtract(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

/// The dot product, summed in eight lanes so that it can be vectorised.
pub fn dot<T: Copy + Into<f64>>(a: &[T], b: &[f64]) -> f64 {
    let count = a.len().min(b.len());
    let ((a, more_a), (b, more_b)) = (a[..count].as_chunks::<8>(), b[..count].as_chunks::<8>());
    let mut lanes = [0.0; 8];
    for (a, b) in a.iter().zip(b) {
        for ((lane, &x), y) in lanes.iter_mut().zip(a).zip(b) {
            *lane += x.into() * y;
        }
    }
    for (lane, (&x, y)) in lanes.iter_mut().zip(more_a.iter().zip(more_b)) {
        *lane += x.into() * y;
    }
    lanes.iter().sum()
}
