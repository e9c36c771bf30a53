//! A problem in the coordinates of its prior, and its solution.

use super::lstsq::{Moments, Solution};
use super::prior::Prior;
use crate::error::{Error, WeightsError};
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatRef, Par, Side};
use lsdc_kernels::cholesky::{PAD, factorise};
use lsdc_kernels::schedule::join;
use lsdc_kernels::simd::Level;

/// A problem in the coordinates of its prior: minimise `|d - s A m - A L u|^2 + lambda |u|^2` over s and u. After s is
/// eliminated, it is a problem in u alone.
pub(super) struct Reduced<'a> {
    pub(super) prior: &'a Prior,
    /// `|A m|^2`, and the value of `s` for u = 0.
    mean_square: f64,
    scale: f64,
    /// `L^T A^T A m / |A m|^2`.
    overlap: Vec<f64>,
    /// The squared length of all columns of `A L`.
    pub(super) trace: f64,
    /// `(P A L)^T P A L`, P projecting away from `A m`.
    pub(super) normal: Mat<f64>,
    /// `(P A L)^T d`.
    pub(super) rhs: Vec<f64>,
    /// `|P d|^2`.
    pub(super) residual_square: f64,
    /// `|d|^2`, used as a unit, so that scaling depths does not change the choice of lambda by a bit.
    pub(super) square: f64,
    /// Number of rows, minus one for the scale.
    pub(super) freedom: f64,
}

/// A solution with a prior.
pub(super) struct Shrunk {
    pub(super) solution: Solution,
    /// The variance of a row of weight 1.
    pub(super) noise: f64,
    pub(super) lambda: f64,
}

/// Share of a sum of squares that may remain from rounding.
pub(super) const ROUNDING: f64 = 1e-13;

impl<'a> Reduced<'a> {
    pub(super) fn new(moments: &Moments, prior: &'a Prior) -> Result<Self, Error> {
        if prior.columns() != moments.rhs.len() {
            return Err(WeightsError::Prior(format!(
                "is one of {} functions, not of {}",
                prior.columns(),
                moments.rhs.len()
            ))
            .into());
        }
        let mean = Mat::from_fn(prior.columns(), 1, |i, _| prior.mean[i]);
        let normal_mean = &moments.normal * &mean;
        let dot = |a: &[f64], b: &Mat<f64>| -> f64 {
            a.iter().enumerate().map(|(i, a)| a * b[(i, 0)]).sum()
        };
        let mean_square = dot(&prior.mean, &normal_mean);
        let toward_mean = dot(&moments.rhs, &mean);
        // Points where the mean map is zero do not determine its scale.
        let is_scale_known = mean_square > f64::MIN_POSITIVE;
        let over = |x: f64| if is_scale_known { x / mean_square } else { 0.0 };
        let overlap = prior.factor.transpose() * normal_mean;
        let overlap: Vec<f64> = overlap.col(0).iter().map(|&v| over(v)).collect();
        let rhs =
            prior.factor.transpose() * Mat::from_fn(prior.columns(), 1, |i, _| moments.rhs[i]);
        let rank = overlap.len();
        let half = product(moments.normal.as_ref(), prior.factor.as_ref());
        let inner = product(prior.factor.transpose(), half.as_ref());
        let residual_square = moments.square - over(toward_mean * toward_mean);
        Ok(Self {
            prior,
            mean_square,
            scale: over(toward_mean),
            trace: (0..rank).map(|i| inner[(i, i)]).sum(),
            normal: Mat::from_fn(rank, rank, |i, j| {
                inner[(i, j)] - overlap[i] * overlap[j] * mean_square
            }),
            rhs: (0..rank)
                .map(|i| rhs[(i, 0)] - overlap[i] * toward_mean)
                .collect(),
            residual_square: if residual_square > ROUNDING * moments.square {
                residual_square
            } else {
                0.0
            },
            square: moments.square,
            freedom: moments.count as f64 - f64::from(u8::from(is_scale_known)),
            overlap,
        })
    }

    /// Whether the points determine the scale.
    fn is_scale_known(&self) -> bool {
        self.mean_square > f64::MIN_POSITIVE
    }

    /// Returns the contribution of the prior on the amplitude of u, in units of the noise: `equivalent_points lambda s^2`.
    pub(super) fn expected(&self, lambda: f64) -> f64 {
        self.prior.noise.expected(lambda, self.scale)
    }

    /// The weights as a function of u, `w = m s + map u`, with s where u is 0: L - m overlap^T.
    pub(super) fn map(&self) -> Mat<f64> {
        let prior = self.prior;
        Mat::from_fn(prior.columns(), self.rhs.len(), |i, j| {
            prior.factor[(i, j)] - prior.mean[i] * self.overlap[j]
        })
    }

    /// The solution for a lambda that is known: by a Cholesky factor `C C^T` of `normal + lambda`, whose further
    /// rows are `map C^-T` and `(C^-1 right)^T`. `None` if rounding errors are as large as lambda.
    pub(super) fn solved(&self, lambda: f64) -> Option<Shrunk> {
        /// Least ratio of lambda to the rounding errors in directions that the points do not determine.
        const ABOVE: f64 = 1e4;
        if lambda.is_nan() || lambda <= ABOVE * ROUNDING * self.trace {
            return None;
        }
        let (rank, columns) = (self.rhs.len(), self.prior.columns());
        let map = self.map();
        let rows = rank + (columns + 1).next_multiple_of(PAD);
        let mut panel = vec![0.0; rows * rank];
        for (j, column) in panel.chunks_exact_mut(rows.max(1)).enumerate().take(rank) {
            let (own, below) = column.split_at_mut(rank);
            own.copy_from_slice(self.normal.col_as_slice(j));
            own[j] += lambda;
            below[..columns].copy_from_slice(map.col_as_slice(j));
            below[columns] = self.rhs[j];
        }
        let (found, determined) = join(
            || factorise(Level::here(), &mut panel, rank, &mut []),
            || self.determined(lambda),
        );
        if !found {
            return None;
        }
        let below = |i: usize, j: usize| panel[j * rows + rank + i];
        let factor = Mat::from_fn(columns, rank, below);
        let along: Vec<f64> = (0..rank).map(|j| below(columns, j)).collect();
        Some(self.shrunk(lambda, &along, factor, determined))
    }

    /// The number of squared singular values of `P A L` above lambda: that of positive eigenvalues of
    /// `normal - lambda`, which are as many as those of the blocks of any of its symmetric factorisations
    /// (Sylvester's law of inertia).
    fn determined(&self, lambda: f64) -> usize {
        let rank = self.rhs.len();
        let mut shifted = self.normal.clone();
        (0..rank).for_each(|i| shifted[(i, i)] -= lambda);
        let blocks = shifted.lblt(Side::Lower);
        let (own, beside) = (
            blocks.B_diag().column_vector(),
            blocks.B_subdiag().column_vector(),
        );
        let (mut count, mut i) = (0, 0);
        while i < rank {
            if i + 1 < rank && beside[i] != 0.0 {
                let opposite = own[i] * own[i + 1] < beside[i] * beside[i];
                count += if opposite {
                    1
                } else {
                    2 * usize::from(own[i] + own[i + 1] > 0.0)
                };
                i += 2;
            } else {
                count += usize::from(own[i] > 0.0);
                i += 1;
            }
        }
        count
    }

    /// Returns the solution from u in coordinates in which its covariance is the identity: u is `along` there, and `factor`
    /// maps these coordinates to the weights. The points determine `determined` of them.
    pub(super) fn shrunk(
        &self,
        lambda: f64,
        along: &[f64],
        factor: Mat<f64>,
        determined: usize,
    ) -> Shrunk {
        let prior = self.prior;
        let mut weights: Vec<f64> = prior.mean.iter().map(|m| m * self.scale).collect();
        for (column, u) in factor.col_iter().zip(along) {
            let pairs = weights.iter_mut().zip(column.iter());
            pairs.for_each(|(w, value)| *w += value * u);
        }
        let (rank, is_scale_known) = (along.len(), self.is_scale_known());
        let factor = Mat::from_fn(
            prior.columns(),
            rank + usize::from(is_scale_known),
            |i, j| {
                if j < rank {
                    factor[(i, j)]
                } else {
                    prior.mean[i] / self.mean_square.sqrt()
                }
            },
        );
        let met: f64 = along.iter().map(|value| value * value).sum();
        let penalised = (self.residual_square - met).max(0.0);
        Shrunk {
            solution: Solution {
                weights,
                rank: determined + usize::from(is_scale_known),
                factor,
            },
            noise: (prior.noise).variance(penalised, lambda, self.scale, self.freedom),
            lambda,
        }
    }
}

/// A product that is too small to be shared among threads.
fn product(left: MatRef<'_, f64>, right: MatRef<'_, f64>) -> Mat<f64> {
    let mut found = Mat::zeros(left.nrows(), right.ncols());
    matmul(found.as_mut(), Accum::Replace, left, right, 1.0, Par::Seq);
    found
}
