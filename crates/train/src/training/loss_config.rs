//! Weights of the losses.

use lsdc_files::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// Weights of the losses.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LossConfig {
    /// Mean absolute depth error in metres.
    pub l1: f64,
    /// Mean squared depth error in square metres.
    pub l2: f64,
    /// Root mean squared error of each fit, averaged, in metres: the metric of evaluations. Images with large errors count less
    /// than in `l2`.
    pub rmse: f64,
    /// Reverse Huber loss (Laina et al. 2016): the absolute error, replaced above a fifth of the largest error of the batch by
    /// a parabola that joins it smoothly; in metres.
    pub berhu: f64,
    /// Mean absolute error of the differences between neighbouring pixels, in metres.
    pub gradient: f64,
    /// Loss of the depth map predicted by the network (`network.mean`), up to scale: absolute and root mean squared differences
    /// of logarithms, without their mean (Eigen et al. 2014).
    pub mean: f64,
    /// Mean absolute weight of the basis functions, in metres.
    pub regularisation: f64,
    /// Exponent of the factor (n / `supervision.points`) on the absolute and root mean squared errors of a fit to n points, so
    /// that fits to few points, which have larger errors, do not dominate.
    pub balance: f64,
    /// Negative log likelihood of the steps of the true depth under the affinities; for fits with a field.
    #[serde(alias = "edges")]
    pub affinities: f64,
    /// Mean squared logarithm of the ratio between affinities and those of the teacher's network; for fits with a field.
    pub teacher_affinities: f64,
    /// Squared fraction of the teacher's basis functions that the network's own cannot represent, each function weighted
    /// equally: from 0 to 1.
    pub teacher_span: f64,
}

impl Default for LossConfig {
    fn default() -> Self {
        Self {
            l1: 1.0,
            l2: 1.0,
            rmse: 0.0,
            berhu: 0.0,
            gradient: 1.0,
            mean: 0.0,
            regularisation: 1e-3,
            balance: 0.0,
            affinities: 0.0,
            teacher_affinities: 0.0,
            teacher_span: 0.0,
        }
    }
}

impl LossConfig {
    /// Returns the weights for the loss of the predicted map alone.
    pub(super) fn of_map(mean: f64) -> Self {
        Self {
            l1: 0.0,
            l2: 0.0,
            gradient: 0.0,
            mean,
            regularisation: 0.0,
            ..Self::default()
        }
    }

    /// Returns whether the network is compared with that of a teacher.
    pub fn compares_networks(&self) -> bool {
        self.teacher_affinities > 0.0 || self.teacher_span > 0.0
    }

    pub(super) fn check(&self) -> Result<()> {
        let all = [
            self.l1,
            self.l2,
            self.rmse,
            self.berhu,
            self.gradient,
            self.mean,
            self.regularisation,
            self.affinities,
            self.teacher_affinities,
            self.teacher_span,
        ];
        if all.iter().all(|w| *w >= 0.0 && w.is_finite())
            && (0.0..=1.0).contains(&self.balance)
            && (self.l1 + self.l2 + self.rmse + self.berhu + self.mean + self.affinities > 0.0
                || self.compares_networks())
        {
            Ok(())
        } else {
            Err(Error::config(
                "`loss`: weights must be at least 0, `balance` from 0 to 1, and `l1`, `l2`, `rmse`, \
                 `berhu`, `mean`, `affinities` or those of a teacher above 0",
            ))
        }
    }
}
