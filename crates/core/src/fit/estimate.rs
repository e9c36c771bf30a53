//! The result of an estimator.

use super::joint::FieldFit;
use super::lstsq::Solution;
use super::points::FitRows;
use std::sync::Arc;

/// The result of an estimator.
#[derive(Clone, Debug)]
pub(super) struct Estimate {
    pub(super) solution: Solution,
    /// The residual of each value.
    pub(super) residuals: Vec<f64>,
    /// The noise variance of a point of weight 1, in square metres.
    pub(super) noise: f64,
    /// The strength of the prior.
    pub(super) lambda: Option<f64>,
    /// The field that is added to the weighted basis functions.
    pub(super) field: Option<Arc<FieldFit>>,
}

impl Estimate {
    pub(super) fn leverages(&self, rows: &FitRows<'_>, weights: &[f64]) -> Vec<f64> {
        match &self.field {
            None => self.solution.leverages(&rows.bases(), weights),
            Some(field) => field.leverages(&self.solution, weights),
        }
    }
}
