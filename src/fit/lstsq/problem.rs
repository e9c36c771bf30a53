//! One least-squares problem in f64: solution and closed-form adjoint.

use super::dot;
use crate::error::{Error, Result};
use faer::linalg::matmul::triangular::{BlockStructure, matmul};
use faer::linalg::solvers::{Llt, Solve as _};
use faer::linalg::triangular_inverse::invert_lower_triangular;
use faer::{Accum, Mat, MatRef, Par, Side};

/// How a problem is solved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Solver {
    /// Truncated SVD: directions with singular values at most this share of the largest are left
    /// out, the rest is the solution of least norm (paper Algorithm 1).
    Truncated(f64),
    /// Normal equations plus this share of their mean diagonal times the identity.
    Ridge(f64),
}

/// Rows scaled by the square root of their weights; rows of weight 0 are left out.
#[derive(Clone, Debug)]
pub struct Problem {
    rows: Vec<usize>,
    roots: Vec<f64>,
    matrix: Mat<f64>,
    pub(super) depths: Vec<f64>,
}

/// Weights of the base functions and the rank they were found with.
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    /// One weight per base function.
    pub weights: Vec<f64>,
    /// Directions that were kept.
    pub rank: usize,
}

/// The kept part of a singular value decomposition: `matrix = u diag(s) v^T`.
pub(super) struct Kept {
    pub(super) u: Mat<f64>,
    pub(super) s: Vec<f64>,
    pub(super) v: Mat<f64>,
}

impl Problem {
    /// `bases` holds one row per depth; all lengths must agree.
    pub fn new(bases: &[f64], depths: &[f64], weights: &[f64]) -> Self {
        let columns = bases.len() / depths.len().max(1);
        let rows: Vec<usize> = (0..depths.len()).filter(|&i| weights[i] > 0.0).collect();
        let roots: Vec<f64> = rows.iter().map(|&i| weights[i].sqrt()).collect();
        let matrix = Mat::from_fn(rows.len(), columns, |i, j| {
            roots[i] * bases[rows[i] * columns + j]
        });
        let depths = rows
            .iter()
            .zip(&roots)
            .map(|(&i, w)| w * depths[i])
            .collect();
        Self {
            rows,
            roots,
            matrix,
            depths,
        }
    }

    /// Solves the problem.
    ///
    /// # Errors
    /// Values that are not finite.
    pub fn solve(&self, solver: Solver) -> Result<Solution> {
        let columns = self.matrix.ncols();
        if self.rows.is_empty() {
            return Ok(Solution {
                weights: vec![0.0; columns],
                rank: 0,
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
                })
            }
            Solver::Ridge(share) => Ok(Solution {
                weights: self.ridge_inverse(share)?(&transposed_times(
                    self.matrix.as_ref(),
                    &self.depths,
                )),
                rank: columns,
            }),
        }
    }

    /// The solution by the normal equations, if they show that nothing is to be left out and are
    /// conditioned well enough to be trusted: several times faster than a decomposition.
    pub(super) fn full_rank(&self, rcond: f64) -> Option<Solution> {
        /// Normal equations square the condition of the matrix, so that f64 leaves 7 digits; a
        /// step of refinement wins back the rest.
        const WORST: f64 = 3e4;
        let columns = self.matrix.ncols();
        if self.rows.len() < columns {
            return None;
        }
        let normal = self.normal();
        let largest = (0..columns).map(|i| normal[(i, i)]).sum::<f64>().sqrt();
        let factor = normal.llt(Side::Lower).ok()?;
        let mut inverse = Mat::<f64>::zeros(columns, columns);
        invert_lower_triangular(inverse.as_mut(), factor.L(), Par::Seq);
        // Frobenius norms are bounds: largest >= s[0] and 1 / smallest >= 1 / s[last].
        let condition = largest * inverse.norm_l2();
        if condition.is_nan() || condition >= WORST.min(1.0 / rcond) {
            return None;
        }
        let matrix = self.matrix.as_ref();
        let solve = |d: &[f64]| solve(&factor, &transposed_times(matrix, d));
        let mut weights = solve(&self.depths);
        let residual = subtract(&self.depths, &times(matrix, &weights));
        let step = solve(&residual);
        weights.iter_mut().zip(step).for_each(|(w, s)| *w += s);
        Some(Solution {
            weights,
            rank: columns,
        })
    }

    /// The lower half of `M^T M`.
    fn normal(&self) -> Mat<f64> {
        let columns = self.matrix.ncols();
        let mut normal = Mat::<f64>::zeros(columns, columns);
        matmul(
            normal.as_mut(),
            BlockStructure::TriangularLower,
            Accum::Replace,
            self.matrix.transpose(),
            BlockStructure::Rectangular,
            self.matrix.as_ref(),
            BlockStructure::Rectangular,
            1.0,
            Par::Seq,
        );
        normal
    }

    /// The gradients of `bases` (row by row) and `depths`, as given to `new` for `count` rows,
    /// from the gradient of the solution. Rows of weight 0 get exactly 0.
    ///
    /// # Errors
    /// Values that are not finite.
    pub fn backward(
        &self,
        grad: &[f64],
        solver: Solver,
        count: usize,
    ) -> Result<(Vec<f64>, Vec<f64>)> {
        let columns = self.matrix.ncols();
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
    fn truncated_adjoint(&self, grad: &[f64], rcond: f64) -> Result<Adjoint> {
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
        Ok(Adjoint {
            bases,
            depths: times(all.u.as_ref(), &over(&p, 1)),
        })
    }

    /// The adjoint of `x = A^-1 M^T d` with `A = M^T M + share trace(M^T M) / k I`.
    fn ridge_adjoint(&self, grad: &[f64], share: f64) -> Result<Adjoint> {
        let matrix = self.matrix.as_ref();
        let inverse = self.ridge_inverse(share)?;
        let x = inverse(&transposed_times(matrix, &self.depths));
        let v = inverse(grad);
        let depths = times(matrix, &v);
        let residual = subtract(&self.depths, &times(matrix, &x));
        let shrink = 2.0 * share / matrix.ncols() as f64 * dot(&v, &x);
        let bases = Mat::from_fn(matrix.nrows(), matrix.ncols(), |i, j| {
            residual[i] * v[j] - depths[i] * x[j] - shrink * matrix[(i, j)]
        });
        Ok(Adjoint { bases, depths })
    }

    /// The inverse of the regularised normal equations, by Cholesky.
    fn ridge_inverse(&self, share: f64) -> Result<impl Fn(&[f64]) -> Vec<f64> + use<>> {
        let columns = self.matrix.ncols();
        let mut normal = self.normal();
        let trace: f64 = (0..columns).map(|i| normal[(i, i)]).sum();
        for i in 0..columns {
            normal[(i, i)] += share * trace / columns as f64;
        }
        let factor = normal.llt(Side::Lower).map_err(|_| {
            Error::fit("the normal equations are not positive definite")
                .hint("raise `fit.ridge`, or set it to 0 for the truncated SVD")
        })?;
        Ok(move |b: &[f64]| solve(&factor, b))
    }

    /// The singular directions with `s > rcond * s[0]`; a QR step first makes tall problems cheap.
    pub(super) fn decompose(&self, rcond: f64) -> Result<Kept> {
        let matrix = self.matrix.as_ref();
        let failed = |_| {
            Error::fit("the singular value decomposition did not converge")
                .hint("base functions or depths are not finite")
        };
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
        Ok(Kept {
            u: u.subcols(0, rank).to_owned(),
            v: v.subcols(0, rank).to_owned(),
            s: s[..rank].to_vec(),
        })
    }
}

/// Gradients with respect to the scaled rows.
struct Adjoint {
    bases: Mat<f64>,
    depths: Vec<f64>,
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
