//! Fits with a prior, which need only a few points.

use super::lstsq::{Moments, Solution};
use super::prior::Prior;
use crate::error::{Error, FitError, WeightsError};
use faer::{Mat, Side};
use serde::{Deserialize, Serialize};

/// How the strength of the prior is chosen: lambda, the ratio of the noise variance to the variance of u.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Lambda {
    /// Maximises the marginal likelihood of the points (empirical Bayes, REML: Patterson and Thompson 1971).
    #[default]
    Evidence,
    /// Minimises the estimated error of predicting points left out (generalised cross-validation: Golub, Heath
    /// and Wahba 1979).
    Gcv,
    /// A fixed value.
    #[serde(untagged)]
    Fixed(f64),
    /// Numbers of points, in ascending order, and the value for each. Values in between are interpolated
    /// logarithmically; beyond the first and the last they stay constant.
    #[serde(untagged)]
    ByCount([(f64, f64); COUNTS]),
}

impl Lambda {
    /// Multiplies the strength by a factor, if it is a given value.
    #[must_use]
    pub fn times(self, factor: f64) -> Self {
        match self {
            Self::Evidence | Self::Gcv => self,
            Self::Fixed(value) => Self::Fixed(value * factor),
            Self::ByCount(values) => {
                Self::ByCount(values.map(|(count, value)| (count, value * factor)))
            }
        }
    }

    /// The same strength for a number of points, whose statistics may be those of fewer.
    pub(super) fn at(self, count: usize) -> Self {
        match self {
            Self::Evidence | Self::Gcv | Self::Fixed(_) => self,
            Self::ByCount(values) => Self::Fixed(by_count(&values, count)),
        }
    }
}

/// The number of pairs in [`Lambda::ByCount`].
pub const COUNTS: usize = 3;

/// The value for a number of points.
fn by_count(values: &[(f64, f64); COUNTS], count: usize) -> f64 {
    let place = (count.max(1) as f64).ln();
    let (first, last) = (values[0], values[COUNTS - 1]);
    for [(from, low), (to, high)] in values.array_windows() {
        let (start, end) = (from.ln(), to.ln());
        if place >= start && place < end {
            let share = (place - start) / (end - start);
            return (low.ln() * (1.0 - share) + high.ln() * share).exp();
        }
    }
    if place < first.0.ln() {
        first.1
    } else {
        last.1
    }
}

/// A problem in the coordinates of its prior: minimise `|d - s A m - A L u|^2 + lambda |u|^2` over
/// s and u. With s eliminated, each direction of u is alone.
struct Spectrum<'a> {
    prior: &'a Prior,
    /// `|A m|^2`, and `s` were u 0.
    mean_square: f64,
    scale: f64,
    /// `L^T A^T A m / |A m|^2`.
    overlap: Vec<f64>,
    /// Squared singular values of `P A L`, P projecting away from `A m`.
    squares: Vec<f64>,
    /// Their right singular vectors.
    directions: Mat<f64>,
    /// The depths in these directions, times the singular values.
    along: Vec<f64>,
    /// `|P d|^2`.
    rest: f64,
    /// `|d|^2`: in its unit, scaling depths changes no bit of what lambda is chosen by.
    square: f64,
    /// Rows, less the one that the scale takes.
    freedom: f64,
}

/// A solution with a prior.
pub(super) struct Shrunk {
    pub(super) solution: Solution,
    /// The variance of a row of weight 1.
    pub(super) noise: f64,
    pub(super) lambda: f64,
    /// The scale of the prior, were u 0.
    pub(super) scale: f64,
}

impl Moments {
    /// Solves the problem with a prior over its weights.
    ///
    /// # Errors
    /// Values that are not finite, or a prior for another number of weights.
    pub(super) fn shrunk(&self, prior: &Prior, lambda: Lambda) -> Result<Shrunk, Error> {
        let spectrum = Spectrum::new(self, prior)?;
        let lambda = spectrum.strength(lambda, self.count);
        Ok(Shrunk {
            solution: spectrum.solution(lambda),
            noise: spectrum.noise(lambda),
            lambda,
            scale: spectrum.scale,
        })
    }
}

impl Moments {
    /// -2 ln p(depths | prior) for a strength of the prior, up to a constant that is the same for all priors.
    ///
    /// # Errors
    /// As for [`Self::shrunk`].
    pub(super) fn surprise(&self, prior: &Prior, lambda: Lambda) -> Result<f64, Error> {
        let spectrum = Spectrum::new(self, prior)?;
        Ok(spectrum.surprise(spectrum.strength(lambda, self.count)))
    }
}

/// The share of a sum of squares that rounding leaves where nothing should be left.
const ROUNDING: f64 = 1e-13;

impl<'a> Spectrum<'a> {
    fn new(moments: &Moments, prior: &'a Prior) -> Result<Self, Error> {
        if prior.columns() != moments.right.len() {
            return Err(WeightsError::Prior(format!(
                "is one of {} functions, not of {}",
                prior.columns(),
                moments.right.len()
            ))
            .into());
        }
        let mean = Mat::from_fn(prior.columns(), 1, |i, _| prior.mean[i]);
        let normal_mean = &moments.normal * &mean;
        let dot = |a: &[f64], b: &Mat<f64>| -> f64 {
            a.iter().enumerate().map(|(i, a)| a * b[(i, 0)]).sum()
        };
        let mean_square = dot(&prior.mean, &normal_mean);
        let toward_mean = dot(&moments.right, &mean);
        // Points where the mean map is zero tell nothing of its scale.
        let seen = mean_square > f64::MIN_POSITIVE;
        let over = |x: f64| if seen { x / mean_square } else { 0.0 };
        let overlap = prior.factor.transpose() * normal_mean;
        let overlap: Vec<f64> = overlap.col(0).iter().map(|&v| over(v)).collect();
        let right =
            prior.factor.transpose() * Mat::from_fn(prior.columns(), 1, |i, _| moments.right[i]);
        let rank = overlap.len();
        let inner = prior.factor.transpose() * &moments.normal * &prior.factor;
        let projected = Mat::from_fn(rank, rank, |i, j| {
            inner[(i, j)] - overlap[i] * overlap[j] * mean_square
        });
        let eigen = projected
            .self_adjoint_eigen(Side::Lower)
            .map_err(|_| FitError::Unsolvable("its eigenvalues did not converge"))?;
        let right: Vec<f64> = (0..rank)
            .map(|i| right[(i, 0)] - overlap[i] * toward_mean)
            .collect();
        let directions = eigen.U().to_owned();
        let mut squares: Vec<f64> = eigen.S().column_vector().iter().copied().collect();
        let along = (0..rank).map(|j| (0..rank).map(|i| directions[(i, j)] * right[i]).sum());
        let mut along: Vec<f64> = along.collect();
        // What rounding leaves of directions that the points do not see.
        let all: f64 = (0..rank).map(|i| inner[(i, i)]).sum();
        for (square, along) in squares.iter_mut().zip(&mut along) {
            if *square <= ROUNDING * all {
                (*square, *along) = (0.0, 0.0);
            }
        }
        let rest = moments.square - over(toward_mean * toward_mean);
        Ok(Self {
            prior,
            mean_square,
            scale: over(toward_mean),
            squares,
            along,
            directions,
            rest: if rest > ROUNDING * moments.square {
                rest
            } else {
                0.0
            },
            square: moments.square,
            freedom: moments.count as f64 - f64::from(u8::from(seen)),
            overlap,
        })
    }

    /// The strength of the prior that is given or found for a number of points.
    fn strength(&self, lambda: Lambda, count: usize) -> f64 {
        match lambda {
            Lambda::Fixed(lambda) => lambda,
            Lambda::ByCount(values) => by_count(&values, count),
            Lambda::Evidence => self.best(|lambda| self.surprise(lambda)),
            Lambda::Gcv => self.best(|lambda| self.cross_validation(lambda)),
        }
    }

    /// `|P (d - A L u)|^2 + lambda |u|^2` at its minimum.
    fn penalised(&self, lambda: f64) -> f64 {
        let pairs = self.along.iter().zip(&self.squares);
        let met: f64 = pairs.map(|(c, g)| c * c / (g + lambda)).sum();
        (self.rest - met).max(0.0)
    }

    /// What the prior of the amplitude of u adds, in units of the noise: `trust lambda s^2`.
    fn expected(&self, lambda: f64) -> f64 {
        self.prior.noise.expected(lambda, self.scale)
    }

    /// The variance of the noise, in square metres.
    fn noise(&self, lambda: f64) -> f64 {
        let (penalised, noise) = (self.penalised(lambda), self.prior.noise);
        noise.variance(penalised, lambda, self.scale, self.freedom)
    }

    /// -2 ln p(depths | lambda) - 2 ln p(lambda), up to a constant: scale and noise integrated out
    /// with flat priors but for the one on the amplitude of u.
    fn surprise(&self, lambda: f64) -> f64 {
        let volume: f64 = self.squares.iter().map(|g| (1.0 + g / lambda).ln()).sum();
        let noise = &self.prior.noise;
        let count = self.freedom + noise.trust;
        let total = self.penalised(lambda) + self.expected(lambda);
        let misfit = if total > 0.0 {
            count * (total / self.square).ln() - noise.trust * lambda.ln()
        } else {
            0.0
        };
        let known = noise
            .deviation
            .map_or(0.0, |d| ((lambda.ln() - noise.mean) / d).powi(2));
        volume + misfit + known
    }

    /// The mean squared residual over the squared share of freedom that is left.
    fn cross_validation(&self, lambda: f64) -> f64 {
        let triples = self.squares.iter().zip(&self.along);
        let (mut residual, mut freedom) = (self.rest, self.freedom);
        for (g, c) in triples {
            residual -= c * c * (g + 2.0 * lambda) / (g + lambda).powi(2);
            freedom -= g / (g + lambda);
        }
        residual.max(0.0) / freedom.max(1e-9).powi(2)
    }

    /// The lambda of the least cost: on a grid first, as there may be several minima, then by
    /// golden section.
    fn best(&self, cost: impl Fn(f64) -> f64) -> f64 {
        const STEP: f64 = 0.5;
        const GOLDEN: f64 = 0.618_033_988_749_894_9;
        let expected = self.prior.noise.mean;
        let largest = self.squares.iter().fold(0.0, |m: f64, &g| m.max(g));
        if largest <= 0.0 || self.rest <= 0.0 {
            return expected.exp();
        }
        let at = |x: f64| cost(x.exp());
        let (low, high) = (largest.ln() - 28.0, largest.ln() + 7.0);
        let steps = ((high - low) / STEP) as usize;
        let grid = (0..=steps).map(|i| low + STEP * i as f64);
        let best = grid.map(|x| (at(x), x)).min_by(|a, b| a.0.total_cmp(&b.0));
        let best = best.map_or(expected, |(_, x)| x);
        let (mut low, mut high) = (best - STEP, best + STEP);
        while high - low > 1e-6 {
            let (a, b) = (high - GOLDEN * (high - low), low + GOLDEN * (high - low));
            if at(a) < at(b) {
                high = b;
            } else {
                low = a;
            }
        }
        f64::midpoint(low, high).exp()
    }

    fn solution(&self, lambda: f64) -> Solution {
        let (prior, rank) = (self.prior, self.squares.len());
        // w = m s + (L - m overlap^T) u, with s where u is 0.
        let map = Mat::from_fn(prior.columns(), rank, |i, j| {
            prior.factor[(i, j)] - prior.mean[i] * self.overlap[j]
        }) * &self.directions;
        let mut weights: Vec<f64> = prior.mean.iter().map(|m| m * self.scale).collect();
        for j in 0..rank {
            let u = self.along[j] / (self.squares[j] + lambda);
            weights
                .iter_mut()
                .enumerate()
                .for_each(|(i, w)| *w += map[(i, j)] * u);
        }
        let seen = self.mean_square > f64::MIN_POSITIVE;
        let factor = Mat::from_fn(prior.columns(), rank + usize::from(seen), |i, j| {
            if j < rank {
                map[(i, j)] / (self.squares[j] + lambda).sqrt()
            } else {
                prior.mean[i] / self.mean_square.sqrt()
            }
        });
        let determined = self.squares.iter().filter(|g| **g > lambda).count();
        Solution {
            weights,
            rank: determined + usize::from(seen),
            factor,
        }
    }
}
