//! Predictions of points by a fit to all others.

use super::mixture::{Predict, Predictions};
use crate::error::Result;
use crate::fit::Estimator;
use crate::fit::outcome::{least_freedom, leave_one_out};
use crate::fit::points::Rows;

/// A fit to all points, in closed form without each of them.
pub(super) struct Refit<'a> {
    pub(super) rows: &'a Rows<'a>,
    pub(super) estimator: Estimator<'a>,
}

impl Predict for Refit<'_> {
    fn predict(&self, noise: &[f64]) -> Result<Predictions> {
        let data = self.estimator.data();
        let field = matches!(self.estimator, Estimator::Field(_));
        let weights: Vec<f64> = noise.iter().map(|v| (data * v).recip()).collect();
        let estimate = self.estimator.solve(self.rows, &weights)?;
        let leverages = estimate.leverages(self.rows, &weights);
        let least = least_freedom(field);
        let pairs = leverages.iter().zip(noise);
        Ok(Predictions {
            variances: pairs
                .map(|(h, noise)| h * noise / (1.0 - h).max(least))
                .collect(),
            errors: leave_one_out(&estimate.rests, &leverages, field),
        })
    }
}
