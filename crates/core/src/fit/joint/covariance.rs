//! The prior covariances of the depths of points under the model of depth.

use super::estimate::FieldEstimator;
use super::smoothness::unsolvable;
use crate::error::Result;
use crate::fit::JointConfig;
use crate::fit::points::FitRows;
use faer::{Mat, Scale};

impl FieldEstimator<'_> {
    /// Returns the covariances of the depths of some points before noise, which has the variance 1 / (data x weight): the
    /// covariances of field, cosines, and basis functions with a prior of the strength `lambda`.
    ///
    /// # Errors
    /// Equations that are not positive definite, or basis functions that are not finite.
    pub(in crate::fit) fn covariance(
        &self,
        rows: &FitRows<'_>,
        which: &[usize],
        lambda: Option<f64>,
    ) -> Result<Mat<f64>> {
        /// Variance of the field relative to that of the mean of the prior, whose scale is unknown.
        const KNOWN: f64 = 1e-3;
        let places = rows.places.unwrap_or_default();
        let interpolation: Vec<_> = which
            .iter()
            .map(|&i| self.geometry.interpolation(places[i]))
            .collect();
        // Without regularisation, the default makes the prior proper.
        let least = JointConfig::default().diagonal_regularisation;
        let regularisation = self.joint.diagonal_regularisation.max(least);
        let prior = self.geometry.affinities.prior(regularisation);
        let prior = prior.ok_or_else(unsolvable)?;
        let mut covariance = prior.covariance(&interpolation);

        let (count, columns) = (which.len(), rows.columns());
        let bases = rows.bases_of(which)?;
        let bases = Mat::from_fn(count, columns, |i, j| f64::from(bases[i * columns + j]));
        let functions = columns - self.ridges.len();
        let cosines = Mat::from_fn(count, self.ridges.len(), |i, j| {
            bases[(i, functions + j)] / self.ridges[j].sqrt()
        });
        covariance += &cosines * cosines.transpose();
        if let (Some((prior, _)), Some(lambda)) = (self.prior, lambda) {
            let bases = bases.subcols(0, functions);
            let free = bases * Mat::from_fn(functions, 1, |i, _| prior.mean[i]);
            let square = free.squared_norm_l2();
            let own: f64 = (0..count).map(|i| covariance[(i, i)]).sum();
            let scale = if square > 0.0 {
                own / KNOWN / square
            } else {
                0.0
            };
            let along = bases * &prior.factor;
            covariance += &along * along.transpose() * Scale(lambda.recip())
                + &free * free.transpose() * Scale(scale);
        }
        Ok(covariance)
    }
}
