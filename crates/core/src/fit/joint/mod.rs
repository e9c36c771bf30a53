//! Basis functions and a smooth field, fitted together.
//!
//! Depth is modelled as F w + y, y being a field that is smooth but for edges of the image
//! ([`crate::field`]), w the weights of the basis functions. Both together minimise
//!
//! > sum over neighbours c_ij (y_i - y_j)^2 + level |y|^2 + data |F_s w + y_s - d|^2 + ridge |w|^2
//!
//! which is universal kriging (Matheron 1969) with a field in place of a covariance function. A
//! local step after a plain fit finds nothing to do, because the basis functions were spent on the
//! points; together, the basis functions take what the field cannot express. Without basis functions
//! it is weighted least squares (Farbman et al. 2008), with a rigid field the paper's fit.

mod estimate;
mod marginal;
mod problem;
mod sites;
#[cfg(test)]
mod tests;

pub(super) use estimate::{FieldEstimator, FieldFit};
pub use problem::{Adjoint, Gradients, JointProblem};

use crate::error::SettingsError;
use serde::{Deserialize, Serialize};

/// How basis functions and field share the depths.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct JointConfig {
    /// How much a point counts against neighbours that are joined with strength 1.
    pub data: f64,
    /// How much the square of a weight counts, if there is no prior over them.
    pub ridge: f64,
    /// How much the square of the field counts at each pixel: what holds it near 0 far from points.
    pub level: f64,
    /// Up to which frequency the cosine basis is part of the field beside basis functions: first
    /// differences alone flatten slopes between points. 0: none; F: cosines as short as half the width
    /// of the image over F.
    #[serde(alias = "waves")]
    pub cosines: f64,
    /// How much the square of a cosine's weight counts at low frequencies.
    pub bending: f64,
}

impl Default for JointConfig {
    fn default() -> Self {
        Self {
            data: 100.0,
            ridge: 1.0,
            level: 1e-7,
            cosines: 0.0,
            // Of 0.2, 0.3, 0.57, 1 and 2 on 60 training frames: the smaller, the better with 500 points
            // (1 % from 1 to 0.2) and the worse with 100 (0.6 %).
            bending: 0.3,
        }
    }
}

impl JointConfig {
    /// For a field alone: without cosines, and drawn to nothing but its points.
    #[must_use]
    pub fn alone(self) -> Self {
        Self {
            level: 0.0,
            cosines: 0.0,
            ..self
        }
    }

    /// Checks every setting.
    ///
    /// # Errors
    /// The first setting that is out of range.
    pub fn check(&self) -> Result<(), SettingsError> {
        /// Of cosines there are about 10 x the square of the frequency.
        const MOST: f64 = 8.0;
        if !(0.0..=MOST).contains(&self.cosines) {
            return Err(SettingsError::new(format!(
                "`joint.cosines` must be from 0 to {MOST}"
            )));
        }
        if [self.data, self.ridge, self.level, self.bending]
            .iter()
            .all(|v| *v > 0.0 && v.is_finite())
        {
            Ok(())
        } else {
            Err(SettingsError::new(
                "`joint.data`, `joint.ridge`, `joint.level` and `joint.bending` must be above 0",
            ))
        }
    }
}
