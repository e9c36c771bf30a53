//! Predictions of points by a fit to all others.

use super::mixture::{Predict, Predictions};
use crate::error::Result;
use crate::fit::Estimator;
use crate::fit::outcome::leave_one_out;
use crate::fit::points::Rows;

/// A fit without a field, in closed form without each point.
pub(super) struct Refit<'a> {
    pub(super) rows: &'a Rows<'a>,
    pub(super) estimator: Estimator<'a>,
}

impl Predict for Refit<'_> {
    fn predict(&self, noise: &[f64]) -> Result<Predictions> {
        /// Less freedom than this is rounding.
        const LEAST: f64 = 1e-3;
        let weights: Vec<f64> = noise.iter().map(|v| v.recip()).collect();
        let estimate = self.estimator.solve(self.rows, &weights)?;
        let spreads = estimate.solution.spreads(&self.rows.bases());
        let pairs = spreads.iter().zip(&weights);
        let leverages: Vec<f64> = pairs
            .clone()
            .map(|(s, w)| (s * w).clamp(0.0, 1.0))
            .collect();
        let left = leverages.iter().map(|h| (1.0 - h).max(LEAST));
        Ok(Predictions {
            errors: leave_one_out(&estimate.rests, &leverages, false),
            variances: spreads.iter().zip(left).map(|(s, left)| s / left).collect(),
        })
    }
}
