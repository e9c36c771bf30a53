//! Estimators of the weights: plain, with a prior, or with a field.

use super::estimate::Estimate;
use super::joint::FieldEstimator;
use super::lambda::Lambda;
use super::lstsq::{Problem, Solver};
use super::points::FitRows;
use super::prior::Prior;
use crate::error::Result;

/// The estimator of the weights of the basis functions, for points with given weights.
#[derive(Clone, Copy, Debug)]
pub(super) enum Estimator<'a> {
    Plain(Solver),
    Shrunk(&'a Prior, Lambda),
    Field(FieldEstimator<'a>),
}

impl Estimator<'_> {
    /// Returns the estimator without the surface spanned by points: a fit that is linear in their depths.
    pub(super) fn roughly(self) -> Self {
        match self {
            Self::Field(field) => Self::Field(FieldEstimator {
                surface: false,
                ..field
            }),
            other => other,
        }
    }

    /// The inverse variance of the noise of a point of weight 1, in the unit of the fit.
    pub(super) fn observation_precision(self) -> f64 {
        match self {
            Self::Field(estimator) => estimator.joint.observation_precision,
            Self::Plain(_) | Self::Shrunk(..) => 1.0,
        }
    }

    pub(super) fn solve(self, rows: &FitRows<'_>, weights: &[f64]) -> Result<Estimate> {
        let problem = || Problem::new(&rows.bases(), &rows.values, weights);
        match self {
            Self::Field(estimator) => estimator.solve(rows, weights),
            Self::Shrunk(prior, lambda) => {
                let found = problem().moments().shrunk(prior, lambda)?;
                Ok(Estimate {
                    residuals: rows.residuals(&found.solution.weights),
                    solution: found.solution,
                    noise: found.noise,
                    lambda: Some(found.lambda),
                    field: None,
                })
            }
            Self::Plain(solver) => {
                let solution = problem().solve(solver)?;
                let residuals = rows.residuals(&solution.weights);
                let squares: f64 = residuals.iter().zip(weights).map(|(r, w)| w * r * r).sum();
                let used = weights.iter().filter(|w| **w > 0.0).count();
                let freedom = used.saturating_sub(solution.rank).max(1);
                Ok(Estimate {
                    solution,
                    residuals,
                    noise: squares / freedom as f64,
                    lambda: None,
                    field: None,
                })
            }
        }
    }
}
