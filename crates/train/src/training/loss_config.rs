//! How much each loss counts.

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
    /// Root of the mean squared error of each fit, averaged, in metres: what evaluations report.
    /// Images that are far off by nature count less than in `l2`.
    pub rmse: f64,
    /// The reverse Huber loss (Laina et al. 2016): the absolute error, or where it is above a fifth of the largest of the
    /// batch a parabola that joins it smoothly; in metres.
    pub berhu: f64,
    /// Mean absolute error of the differences between neighbouring pixels, in metres.
    pub gradient: f64,
    /// How far the map that the network suggests (`network.mean`) is from the depth, up to scale: the absolute and the
    /// root mean squared differences of their logarithms, without their mean (Eigen et al. 2014).
    pub mean: f64,
    /// Mean absolute weight of a basis function, in metres.
    pub regularisation: f64,
    /// The absolute and root mean squared errors of a fit to n points are multiplied by (n / `supervision.points`)
    /// to this power, so that fits to few points, whose errors are larger by nature, do not drown the others.
    pub balance: f64,
    /// How unlikely the steps of the true depth are, given how far affinities let neighbours differ;
    /// for fits with a field.
    #[serde(alias = "edges")]
    pub affinities: f64,
    /// Mean squared logarithm of the ratio of affinities to those of the teacher's network; for fits with a field.
    pub teacher_affinities: f64,
    /// The share of the basis functions of the teacher's network that the network's own cannot represent, in squares,
    /// each function counting the same: from 0 to 1.
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
    /// The loss of the map that the network suggests, and no other.
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

    /// Whether the network of a teacher is compared with.
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
