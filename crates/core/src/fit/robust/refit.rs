//! Predictions of points by a fit to all others.

use super::mixture::{Predict, Predictions};
use crate::bilinear::InterpolationWeights;
use crate::error::Result;
use crate::fit::estimate::Estimate;
use crate::fit::estimator::Estimator;
use crate::fit::leave_one_out::{least_freedom, leave_one_out};
use crate::fit::points::FitRows;
use rayon::prelude::*;

/// A fit to all points, in closed form without each of them.
pub(super) struct Refit<'a> {
    pub(super) rows: &'a FitRows<'a>,
    estimator: Estimator<'a>,
}

impl<'a> Refit<'a> {
    pub(super) fn new(rows: &'a FitRows<'a>, estimator: Estimator<'a>) -> Self {
        Self { rows, estimator }
    }

    /// Fits points with these noise variances; also returns their weights.
    fn fit(&self, noise: &[f64]) -> Result<(Estimate, Vec<f64>)> {
        let observation_precision = self.estimator.observation_precision();
        let weights: Vec<f64> = noise
            .iter()
            .map(|v| (observation_precision * v).recip())
            .collect();
        Ok((self.estimator.solve(self.rows, &weights)?, weights))
    }

    /// Predicts other points by the field alone, which is fitted to all of these. Each other point is given by its
    /// interpolation weights and its value.
    pub(super) fn others(
        &self,
        noise: &[f64],
        others: impl IndexedParallelIterator<Item = (InterpolationWeights, f64)>,
    ) -> Result<Predictions> {
        let (estimate, _) = self.fit(noise)?;
        let field = estimate.field.as_deref();
        let found = others.map(|(interpolation, value)| {
            let (mean, variance) = field.map_or((0.0, 0.0), |field| field.at(&interpolation));
            (value - mean, variance)
        });
        let (errors, variances) = found.unzip();
        Ok(Predictions { errors, variances })
    }
}

impl Predict for Refit<'_> {
    fn predict(&self, noise: &[f64]) -> Result<Predictions> {
        let field = matches!(self.estimator, Estimator::Field(_));
        let (estimate, weights) = self.fit(noise)?;
        let leverages = estimate.leverages(self.rows, &weights);
        let least = least_freedom(field);
        let pairs = leverages.iter().zip(noise);
        Ok(Predictions {
            variances: pairs
                .map(|(h, noise)| h * noise / (1.0 - h).max(least))
                .collect(),
            errors: leave_one_out(&estimate.residuals, &leverages, field),
        })
    }
}
