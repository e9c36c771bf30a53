//! The prior over the weights of the basis functions: a Gaussian, up to the scale of the scene.
//!
//! Weights are s (m + L u), where u is standard normal, m and L L^T are the mean and covariance over training
//! images scaled to a mean depth of 1, and nothing is assumed about the scale s. So the fit stays exactly
//! scale equivariant, and a single point sets the scale of a plausible map.
//!
//! Which weights are likely depends on the image, in ways that no single Gaussian describes. For many points, fits are centred
//! on the mean of the weights over images; but for very few points, depth is predicted best by the weights of the regression
//! over the pixels of all images. Therefore m moves from these weights, for a single point, to the mean.

use super::FitPoints;
use super::lstsq::{Moments, Problem};
use crate::error::{FitError, WeightsError};
use faer::linalg::solvers::Solve as _;
use faer::{Mat, Side};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// A Gaussian over weights, up to their scale.
#[derive(Clone, Debug, PartialEq)]
pub struct Prior {
    /// m.
    pub(super) mean: Vec<f64>,
    /// L `[k, r]`.
    pub(super) factor: Mat<f64>,
    pub(super) noise: NoisePrior,
    /// The replacement of m for a single point, if there is one.
    pooled: Option<Vec<f64>>,
}

/// Number of points from which on m is the mean over images.
const MANY: f64 = 50.0;

/// The prior over the noise, given as the distribution of lambda, the ratio of the noise variance to the
/// variance of u.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NoisePrior {
    /// Mean of ln(lambda).
    pub mean: f64,
    /// Standard deviation of ln(lambda); absent if lambda is unknown.
    pub deviation: Option<f64>,
    /// Weight of the learned prior on the size of u, as a number of points: `trust` in weights files.
    #[serde(rename = "trust")]
    pub equivalent_points: f64,
}

impl NoisePrior {
    /// Returns the contribution of the amplitude of u to a sum of squares, for a scale s: `equivalent_points lambda s^2`.
    pub(super) fn expected(self, lambda: f64, scale: f64) -> f64 {
        self.equivalent_points * lambda * scale * scale
    }

    /// The variance of the noise from a sum of squares with its penalty and the degrees of freedom.
    pub(super) fn variance(self, penalised: f64, lambda: f64, scale: f64, freedom: f64) -> f64 {
        let count = freedom + self.equivalent_points;
        if count > 0.0 {
            (penalised + self.expected(lambda, scale)) / count
        } else {
            0.0
        }
    }
}

impl Prior {
    /// The prior without training: the constant is unpenalised, the other weights have equal variances.
    pub fn flat(columns: usize) -> Self {
        let mut mean = vec![0.0; columns];
        if let Some(constant) = mean.first_mut() {
            *constant = 1.0;
        }
        Self {
            mean,
            factor: Mat::from_fn(columns, columns.saturating_sub(1), |i, j| {
                f64::from(i == j + 1)
            }),
            noise: NoisePrior {
                mean: 0.0,
                deviation: None,
                equivalent_points: 0.0,
            },
            pooled: None,
        }
    }

    /// A prior from its parameters: `mean [k]` and `factor [k, r]`, row by row.
    ///
    /// # Errors
    /// Lengths that do not match, or values that are not finite.
    pub fn new(mean: &[f32], factor: &[f32], noise: NoisePrior) -> Result<Self, WeightsError> {
        let columns = mean.len();
        let whole = columns > 0 && factor.len().is_multiple_of(columns);
        let numbers = [
            noise.mean,
            noise.deviation.unwrap_or(1.0),
            noise.equivalent_points,
        ];
        let finite = mean.iter().chain(factor).all(|v| v.is_finite())
            && numbers.iter().all(|v| v.is_finite())
            && noise.deviation.is_none_or(|d| d > 0.0)
            && noise.equivalent_points >= 0.0;
        if !(whole && finite) {
            return Err(WeightsError::Prior("is damaged".to_owned()));
        }
        let rank = factor.len() / columns;
        Ok(Self {
            mean: mean.iter().map(|&v| f64::from(v)).collect(),
            factor: Mat::from_fn(columns, rank, |i, j| f64::from(factor[i * rank + j])),
            noise,
            pooled: None,
        })
    }

    /// The same prior, centred on other weights for a single point, and gradually less so for more points.
    ///
    /// # Errors
    /// Another number of weights, or some that are not finite.
    pub fn with_pooled(self, weights: &[f32]) -> Result<Self, WeightsError> {
        if weights.len() != self.columns() || !weights.iter().all(|w| w.is_finite()) {
            return Err(WeightsError::Prior("is damaged".to_owned()));
        }
        let pooled = Some(weights.iter().map(|&w| f64::from(w)).collect());
        Ok(Self { pooled, ..self })
    }

    /// The weights on which the prior is centred for a single point; `None` if they are its mean.
    pub fn pooled(&self) -> Option<Vec<f32>> {
        let pooled = self.pooled.as_ref()?;
        Some(pooled.iter().map(|&w| w as f32).collect())
    }

    /// The prior for a number of points.
    pub(super) fn at(&self, count: usize) -> Cow<'_, Self> {
        let share = 1.0 - (count.max(1) as f64).ln() / MANY.ln();
        match &self.pooled {
            Some(pooled) if share > 0.0 => {
                let pairs = self.mean.iter().zip(pooled);
                Cow::Owned(Self {
                    mean: pairs.map(|(m, p)| m + share * (p - m)).collect(),
                    pooled: None,
                    ..self.clone()
                })
            }
            _ => Cow::Borrowed(self),
        }
    }

    /// The same prior, its deviations times `share`, and `guides` more functions, whose weights have mean 0 and the
    /// standard deviation `deviation`.
    pub(super) fn with_guides(&self, share: f64, guides: usize, deviation: f64) -> Self {
        let (columns, rank) = (self.columns(), self.factor.ncols());
        let mut mean = self.mean.clone();
        mean.resize(columns + guides, 0.0);
        let more = if deviation > 0.0 { guides } else { 0 };
        Self {
            mean,
            factor: Mat::from_fn(columns + guides, rank + more, |i, j| {
                match (i.checked_sub(columns), j.checked_sub(rank)) {
                    (None, None) => share * self.factor[(i, j)],
                    (Some(i), Some(j)) if i == j => deviation,
                    _ => 0.0,
                }
            }),
            noise: self.noise,
            pooled: None,
        }
    }

    /// The number of weights.
    pub fn columns(&self) -> usize {
        self.mean.len()
    }

    /// The mean, and the factor row by row, in the form of the arguments of `new`.
    pub fn numbers(&self) -> (Vec<f32>, Vec<f32>) {
        let mean = self.mean.iter().map(|&v| v as f32).collect();
        let rows = self.factor.row_iter();
        let factor = rows.flat_map(|row| row.iter().map(|&v| v as f32).collect::<Vec<_>>());
        (mean, factor.collect())
    }

    /// The prior over the noise.
    pub fn noise(&self) -> NoisePrior {
        self.noise
    }

    /// The same prior with another prior over the noise.
    #[must_use]
    pub fn with_noise(self, noise: NoisePrior) -> Self {
        Self { noise, ..self }
    }

    /// The same covariance around other weights, of any scale. Weights of cosines that follow are ignored.
    ///
    /// # Errors
    /// Weights of other basis functions, that are not finite, or that are all 0.
    pub fn centred_on(&self, weights: &[f64], cosines: usize) -> Result<Self, FitError> {
        let expected = self.columns() + cosines;
        if weights.len() != expected {
            let found = weights.len();
            return Err(FitError::OtherWeights { expected, found });
        }
        let mean = &weights[..self.columns()];
        if !mean.iter().all(|w| w.is_finite()) || mean.iter().all(|w| *w == 0.0) {
            return Err(FitError::NearNothing);
        }
        Ok(Self {
            mean: mean.to_vec(),
            pooled: None,
            ..self.clone()
        })
    }

    /// Learns mean and covariance from images whose depths were divided by their mean: the maximum likelihood
    /// estimate, by expectation maximisation (EM; Dempster, Laird and Rubin 1977), starting from a constant
    /// depth. The noise, in the same unit, is the same for all images.
    ///
    /// # Errors
    /// Fewer than two images, or basis functions that are not finite.
    pub fn learn(images: &[ImageMoments]) -> Result<Self, FitError> {
        const ROUNDS: usize = 30;
        if images.len() < 2 {
            return Err(FitError::TooFewPoints(
                "a prior over weights needs two images at least",
            ));
        }
        let columns = images.first().map_or(0, |image| image.0.rhs.len());
        let singular = |_| FitError::Unsolvable("the prior over weights cannot be learned");
        let mut prior = Self::flat(columns);
        let mut covariance = Mat::<f64>::identity(columns, columns) * faer::Scale(0.1);
        let mut noise = 0.01;
        for _ in 0..ROUNDS {
            let precision = inverse(&covariance).map_err(singular)?;
            let expected: Vec<(Vec<f64>, Mat<f64>)> = images
                .par_iter()
                .map(|ImageMoments(image)| {
                    let system = &image.normal * faer::Scale(1.0 / noise) + &precision;
                    let spread = inverse(&system)?;
                    let pull = &precision * column(&prior.mean);
                    let rhs = Mat::from_fn(columns, 1, |i, _| image.rhs[i] / noise + pull[(i, 0)]);
                    let weights = &spread * rhs;
                    Ok((weights.col(0).iter().copied().collect(), spread))
                })
                .collect::<std::result::Result<_, NotPositive>>()
                .map_err(singular)?;
            let total = images.len() as f64;
            prior.mean.fill(0.0);
            for (weights, _) in &expected {
                let pairs = prior.mean.iter_mut().zip(weights);
                pairs.for_each(|(m, w)| *m += w / total);
            }
            let off = Mat::from_fn(columns, images.len(), |i, j| {
                (expected[j].0[i] - prior.mean[i]) / total.sqrt()
            });
            covariance = &off * off.transpose();
            let (mut squares, mut count) = (0.0, 0.0);
            for (ImageMoments(image), (weights, spread)) in images.iter().zip(&expected) {
                covariance += spread * faer::Scale(1.0 / total);
                squares += expected_square(image, weights, spread);
                count += image.count as f64;
            }
            noise = (squares / count).max(f64::MIN_POSITIVE);
        }
        let spectrum = covariance
            .self_adjoint_eigen(Side::Lower)
            .map_err(|_| singular(NotPositive))?;
        let (values, directions) = (spectrum.S().column_vector(), spectrum.U());
        prior.factor = Mat::from_fn(columns, columns, |i, j| {
            directions[(i, j)] * values[j].max(0.0).sqrt()
        });
        prior.noise.mean = noise.ln();
        prior.pooled = Some(pooled(images, columns).map_err(singular)?);
        Ok(prior)
    }
}

/// The sufficient statistics of one training image for learning a prior.
#[derive(Clone, Debug)]
pub struct ImageMoments(Moments);

impl ImageMoments {
    /// The statistics of points whose depths are divided by their mean.
    ///
    /// # Errors
    /// No points, or values that are not finite.
    pub fn new(points: &FitPoints<'_>) -> Result<Self, FitError> {
        let rows = points.rows()?;
        let mean = rows.values.iter().sum::<f64>() / rows.values.len() as f64;
        let depths: Vec<f64> = rows.values.iter().map(|d| d / mean).collect();
        let problem = Problem::new(&rows.bases(), &depths, &rows.weights);
        Ok(Self(problem.moments()))
    }
}

/// The weights that fit the depths of all images at once.
fn pooled(images: &[ImageMoments], columns: usize) -> std::result::Result<Vec<f64>, NotPositive> {
    /// Relative to the mean square of all functions: some may be 0 in all images.
    const RIDGE: f64 = 1e-6;
    let mut normal = Mat::<f64>::zeros(columns, columns);
    let mut rhs = vec![0.0; columns];
    for ImageMoments(image) in images {
        normal += &image.normal;
        rhs.iter_mut()
            .zip(&image.rhs)
            .for_each(|(sum, r)| *sum += r);
    }
    let mean = (0..columns).map(|i| normal[(i, i)]).sum::<f64>() / columns.max(1) as f64;
    (0..columns).for_each(|i| normal[(i, i)] += RIDGE * mean);
    let weights = inverse(&normal)? * column(&rhs);
    Ok(weights.col(0).iter().copied().collect())
}

/// The expected sum of squared residuals under weights with this mean and covariance.
fn expected_square(image: &Moments, weights: &[f64], spread: &Mat<f64>) -> f64 {
    let mut sum = image.square;
    for (i, w) in weights.iter().enumerate() {
        sum -= 2.0 * w * image.rhs[i];
        for (j, v) in weights.iter().enumerate() {
            sum += (w * v + spread[(i, j)]) * image.normal[(i, j)];
        }
    }
    sum
}

struct NotPositive;

fn inverse(matrix: &Mat<f64>) -> std::result::Result<Mat<f64>, NotPositive> {
    let size = matrix.nrows();
    let factor = matrix.llt(Side::Lower).map_err(|_| NotPositive)?;
    Ok(factor.solve(Mat::<f64>::identity(size, size)))
}

fn column(values: &[f64]) -> Mat<f64> {
    Mat::from_fn(values.len(), 1, |i, _| values[i])
}
