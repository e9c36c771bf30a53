//! Robust fits, which limit the influence of outliers.

mod local;
mod mixture;
mod outlier_test;
mod refit;
mod reweighted;
#[cfg(test)]
mod tests;

pub use mixture::InlierPosterior;
pub(super) use outlier_test::inlier_posteriors;

use super::estimate::Estimate;
use super::estimator::Estimator;
use super::points::FitRows;
use crate::error::{Result, SettingsError};
use serde::{Deserialize, Serialize};

/// Robust losses: how the weight of a point decreases with its residual r, or `auto`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Loss {
    /// 1 / max(threshold, |r|): least absolute residuals (the paper's).
    #[default]
    Irls,
    /// Quadratic up to the scale, linear beyond (Huber 1964).
    Huber,
    /// 1 / (1 + u^2), u = r / scale.
    Cauchy,
    /// 1 / (1 + u^2)^2 (Geman and McClure 1987).
    Gm,
    /// (1 - u^2)^2 up to the scale, 0 beyond (Beaton and Tukey 1974).
    Tukey,
    /// No loss function: each point's influence is the probability, given the others, that it is an inlier.
    Auto,
}

impl Loss {
    /// All losses.
    pub const ALL: [Self; 6] = [
        Self::Irls,
        Self::Huber,
        Self::Cauchy,
        Self::Gm,
        Self::Tukey,
        Self::Auto,
    ];

    /// The name in configs and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Irls => "irls",
            Self::Huber => "huber",
            Self::Cauchy => "cauchy",
            Self::Gm => "gm",
            Self::Tukey => "tukey",
            Self::Auto => "auto",
        }
    }
}

/// Settings of a robust fit; the paper leaves the threshold and the stopping criterion open.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Robust {
    /// The loss.
    pub loss: Loss,
    /// For `irls`: residuals below this fraction of the median depth (or inverse depth) have equal weight. It
    /// is relative, so that scaling all depths scales the result. The other losses derive their scale from
    /// the residuals.
    pub threshold: f64,
    /// The scale of the other losses, in standard deviations of the noise; if absent, the classic constant of
    /// each loss.
    pub tuning: Option<f64>,
    /// The other losses use the difference between a residual and the median of the residuals of this many
    /// nearest points: what basis functions cannot represent is similar among neighbours, outliers are not. 0
    /// uses the residual itself.
    pub neighbours: usize,
    /// The largest number of solves after the first.
    pub iterations: usize,
    /// Stops when no residual changes by more than this fraction of the largest depth.
    pub tolerance: f64,
}

impl Default for Robust {
    fn default() -> Self {
        Self {
            loss: Loss::Irls,
            threshold: 1e-3,
            tuning: None,
            neighbours: 6,
            iterations: 10,
            tolerance: 1e-4,
        }
    }
}

impl Robust {
    /// The default settings of a loss. A redescending loss needs more iterations, because its scale shrinks
    /// from one to the next.
    pub fn new(loss: Loss) -> Self {
        Self {
            loss,
            iterations: if loss.redescends() { 40 } else { 10 },
            ..Self::default()
        }
    }

    pub(super) fn check(self) -> Result<(), SettingsError> {
        /// Neighbours of a point, and rounds.
        const MOST: usize = 1000;
        let positive = |v: f64| v > 0.0 && v.is_finite();
        if self.neighbours > MOST || self.iterations > MOST {
            return Err(SettingsError::new(format!(
                "`fit.robust`: neighbours and iterations must be at most {MOST}"
            )));
        }
        let fine = positive(self.threshold) && self.tuning.is_none_or(positive);
        if fine && self.tolerance >= 0.0 {
            Ok(())
        } else {
            Err(SettingsError::new(
                "`fit.robust`: threshold and tuning must be above 0, tolerance at least 0",
            ))
        }
    }
}

/// Continues from the plain estimate. Returns the last estimate and the point weights it was found with.
///
/// # Errors
/// A decomposition that does not converge.
pub(super) fn robust(
    rows: &FitRows<'_>,
    estimator: Estimator<'_>,
    mut plain: Estimate,
    settings: Robust,
) -> Result<(Estimate, Vec<f64>)> {
    if settings.loss != Loss::Auto {
        let (found, weights) = reweighted::reweighted(rows, estimator.roughly(), plain, settings)?;
        return Ok(match estimator {
            Estimator::Field(_) => (estimator.solve(rows, &weights)?, weights),
            _ => (found, weights),
        });
    }
    // Its field holds memory that the next fields need.
    plain.field = None;
    let observation_precision = estimator.observation_precision();
    let posteriors = inlier_posteriors(rows, estimator.roughly(), &plain)?.into_iter();
    let weights: Vec<f64> = posteriors
        .map(|found| found.precision / observation_precision)
        .collect();
    Ok((estimator.solve(rows, &weights)?, weights))
}
