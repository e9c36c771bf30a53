//! Settings of the fit.

use super::lstsq::Solver;
use super::{JointConfig, Lambda, Robust, Space};
use crate::error::SettingsError;
use serde::{Deserialize, Serialize};
use std::fmt::{Display, Formatter};

/// What is assumed of the weights before any depth is seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PriorKind {
    /// Nothing: the paper's fit, or a ridge.
    #[default]
    None,
    /// Equal variances, the constant free.
    Flat,
    /// Mean and covariance over training images, which the weights file holds.
    Learned,
}

impl PriorKind {
    /// All kinds.
    pub const ALL: [Self; 3] = [Self::None, Self::Flat, Self::Learned];

    /// The name in configs and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Flat => "flat",
            Self::Learned => "learned",
        }
    }
}

/// What depth is made of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FitMethod {
    /// Basis functions alone: the paper's least squares.
    #[default]
    Lse,
    /// A field that is smooth but for edges, alone; earlier versions called it "wls".
    #[serde(alias = "wls")]
    Field,
    /// Both, fitted together.
    Joint,
}

impl FitMethod {
    /// All methods.
    pub const ALL: [Self; 3] = [Self::Lse, Self::Field, Self::Joint];

    /// The name in configs and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Lse => "lse",
            Self::Field => "field",
            Self::Joint => "joint",
        }
    }
}

/// How weights are found; the defaults are the paper's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FitConfig {
    /// What depth is made of: "lse" (the paper's basis functions), "field" (one that is smooth but
    /// for edges) or "joint" (both).
    pub method: FitMethod,
    /// How basis functions and field share the depths.
    pub joint: JointConfig,
    /// Singular values below this share of the largest are left out (paper Algorithm 1). The
    /// default is 129 times the epsilon of f32.
    pub rcond: f64,
    /// Added to the normal equations, as a share of their mean diagonal; 0 is the paper's fit.
    pub ridge: f64,
    /// What is assumed of the weights: "none", "flat" or "learned". Takes the place of `rcond` and
    /// `ridge`.
    pub prior: PriorKind,
    /// How strongly the fit is drawn towards the prior: "evidence", "gcv", the ratio of the variances
    /// of noise and prior, or three pairs of a number of points and that ratio.
    pub lambda: Lambda,
    /// What basis functions add up to: "depth" (the paper's), "log" or "inverse" depth.
    pub space: Space,
    /// A fit that does not follow outliers (paper Algorithm 2).
    #[serde(alias = "irls")]
    pub robust: Option<Robust>,
}

impl Default for FitConfig {
    fn default() -> Self {
        Self {
            method: FitMethod::Lse,
            joint: JointConfig::default(),
            rcond: 1.5e-5,
            ridge: 0.0,
            prior: PriorKind::None,
            lambda: Lambda::Evidence,
            space: Space::Depth,
            robust: None,
        }
    }
}

impl FitConfig {
    /// The solver of one linear problem without a prior.
    #[doc(hidden)]
    pub fn solver(&self) -> Solver {
        if self.ridge > 0.0 {
            Solver::Ridge(self.ridge)
        } else {
            Solver::Truncated(self.rcond)
        }
    }

    /// Up to which frequency the cosine basis is part of the field.
    #[doc(hidden)]
    pub fn cosines(&self) -> f64 {
        match self.method {
            FitMethod::Joint => self.joint.cosines,
            FitMethod::Lse | FitMethod::Field => 0.0,
        }
    }

    /// How strongly weights are drawn to their prior beside a field: as in training, if nothing is
    /// assumed of them.
    pub(super) fn field_lambda(&self) -> Lambda {
        match self.prior {
            PriorKind::None => Lambda::Fixed(self.joint.ridge),
            PriorKind::Flat | PriorKind::Learned => self.lambda,
        }
    }

    /// Checks every setting.
    ///
    /// # Errors
    /// The first setting that is out of range.
    pub fn check(&self) -> Result<(), SettingsError> {
        if !(0.0..1.0).contains(&self.rcond) {
            return Err(SettingsError::new("`fit.rcond` must be in [0, 1)"));
        }
        if !(self.ridge >= 0.0 && self.ridge.is_finite()) {
            return Err(SettingsError::new("`fit.ridge` must be 0 or more"));
        }
        let sound = |value: f64| value > 0.0 && value.is_finite();
        let (positive, rising) = match self.lambda {
            Lambda::Evidence | Lambda::Gcv => (true, true),
            Lambda::Fixed(lambda) => (sound(lambda), true),
            Lambda::ByCount(values) => (
                values
                    .iter()
                    .all(|&(count, value)| sound(count) && sound(value)),
                values.is_sorted_by(|a, b| a.0 < b.0),
            ),
        };
        if !positive {
            return Err(SettingsError::new("`fit.lambda` must be above 0"));
        }
        if !rising {
            return Err(SettingsError::new(
                "the numbers of points of `fit.lambda` must rise",
            ));
        }
        if self.method != FitMethod::Lse && self.space != Space::Depth {
            return Err(SettingsError::new(
                "a field is fitted to depths: `fit.space = \"depth\"`",
            ));
        }
        self.joint.check()?;
        self.robust.map_or(Ok(()), Robust::check)
    }
}

impl Display for FitConfig {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        match self.method {
            FitMethod::Lse => {}
            FitMethod::Field => return write!(f, "an edge-aware field alone"),
            FitMethod::Joint => write!(f, "with an edge-aware field, ")?,
        }
        match self.space {
            Space::Depth => write!(f, "fit")?,
            space => write!(f, "fit in {} depth", space.name())?,
        }
        match (self.prior, self.lambda) {
            (PriorKind::None, _) if self.method == FitMethod::Joint => {
                write!(f, " with a ridge of {}", self.joint.ridge)?;
            }
            (PriorKind::None, _) if self.ridge > 0.0 => {
                write!(f, " with a ridge of {}", self.ridge)?;
            }
            (PriorKind::None, _) => write!(f, " by SVD, truncated at {}", self.rcond)?,
            (prior, Lambda::Fixed(lambda)) => {
                write!(f, " with the {} prior, lambda {lambda}", prior.name())?;
            }
            (prior, Lambda::ByCount(values)) => {
                write!(f, " with the {} prior, lambda", prior.name())?;
                for (count, lambda) in values {
                    write!(f, " {lambda:.2e} at {count}")?;
                }
                write!(f, " points")?;
            }
            (prior, Lambda::Evidence) => write!(f, " with the {} prior by evidence", prior.name())?,
            (prior, Lambda::Gcv) => {
                write!(f, " with the {} prior by cross-validation", prior.name())?;
            }
        }
        match self.robust {
            None => Ok(()),
            Some(robust) => write!(
                f,
                ", {} of up to {} rounds",
                robust.loss.name(),
                robust.iterations
            ),
        }
    }
}
