//! Basis functions and a smooth field, fitted jointly.
//!
//! Depth is modelled as F w + y, where y is a field that is smooth except across edges of the image
//! ([`crate::field`]) and w are the weights of the basis functions. Together they minimise
//!
//! > sum over neighbours c_ij (y_i - y_j)^2 + e |y|^2 + a |F_s w + y_s - d|^2 + ridge |w|^2
//!
//! with e the diagonal regularisation (`level`) and a the observation precision (`data`),
//! which is universal kriging (Matheron 1969) with a field in place of a covariance function. Fitting a field
//! to the residuals of a plain fit afterwards gains nothing, because the basis functions have already been
//! used up to match the points; jointly, the basis functions represent what the field cannot. Without basis
//! functions the fit is weighted least squares (Farbman et al. 2008); with an infinitely stiff field it is
//! the paper's fit.

mod coarse;
mod covariance;
mod crowded;
mod estimate;
mod fitted;
mod holes;
mod marginal;
mod merged_observations;
mod problem;
mod smoothness;
mod stacking;
mod surface;
#[cfg(test)]
mod tests;
mod weight_estimate;

pub(super) use estimate::FieldEstimator;
pub(super) use fitted::FieldFit;
pub use fitted::Variances;
pub use problem::{Adjoint, Gradients};

use crate::error::SettingsError;
use crate::field;
use serde::{Deserialize, Serialize};

/// Settings of the joint fit of basis functions and field.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct JointConfig {
    /// Precision of an observation of weight 1, relative to an affinity of 1 between neighbouring pixels: `data` in
    /// configs.
    #[serde(rename = "data")]
    pub observation_precision: f64,
    /// Penalty on the square of each weight, if there is no prior over the weights.
    pub ridge: f64,
    /// Penalty on the square of the field at each pixel, which keeps it near 0 far from points: `level` in configs.
    #[serde(rename = "level")]
    pub diagonal_regularisation: f64,
    /// Highest frequency of the cosine basis, which is part of the field, because first differences alone
    /// flatten slopes between points. 0: no cosines; F: wavelengths down to half the width of the image
    /// divided by F.
    #[serde(alias = "waves")]
    pub cosines: f64,
    /// Whether the field follows the surface spanned by the points, where that is plausible.
    pub surface: bool,
    /// Penalty on the square of a cosine's weight at low frequencies.
    pub bending: f64,
}

impl Default for JointConfig {
    fn default() -> Self {
        Self {
            observation_precision: 100.0,
            ridge: 1.0,
            diagonal_regularisation: 1e-7,
            cosines: 0.0,
            surface: true,
            // Of 0.2, 0.3, 0.57, 1 and 2 on 60 training frames: the smaller, the better with 500 points
            // (1 % from 1 to 0.2) and the worse with 100 (0.6 %).
            bending: 0.3,
        }
    }
}

impl JointConfig {
    /// The settings for a field alone: without cosines and without regularisation of the diagonal.
    #[must_use]
    pub fn alone(self) -> Self {
        Self {
            diagonal_regularisation: 0.0,
            cosines: 0.0,
            ..self
        }
    }

    /// Checks every setting.
    ///
    /// # Errors
    /// The first setting that is out of range.
    pub fn check(&self) -> Result<(), SettingsError> {
        /// The number of cosines is about 10 x the square of the frequency.
        const MOST: f64 = 8.0;
        if !(0.0..=MOST).contains(&self.cosines) {
            return Err(SettingsError::new(format!(
                "`joint.cosines` must be from 0 to {MOST}"
            )));
        }
        if !(self.diagonal_regularisation >= field::LEAST_REGULARISATION
            && self.diagonal_regularisation.is_finite())
        {
            return Err(SettingsError::new(format!(
                "`joint.level` must be at least {:e}",
                field::LEAST_REGULARISATION
            )));
        }
        if [self.observation_precision, self.ridge, self.bending]
            .iter()
            .all(|v| *v > 0.0 && v.is_finite())
        {
            Ok(())
        } else {
            Err(SettingsError::new(
                "`joint.data`, `joint.ridge` and `joint.bending` must be above 0",
            ))
        }
    }
}
