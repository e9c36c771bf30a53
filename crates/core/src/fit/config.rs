//! Settings of the fit.

use super::lstsq::Solver;
use super::{JointConfig, Lambda, Loss, Robust};
use crate::error::SettingsError;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};
use std::fmt::{Display, Formatter};

/// The prior over the weights of the basis functions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PriorKind {
    /// None: the paper's fit, or a ridge.
    #[default]
    None,
    /// Equal variances, with the constant unpenalised.
    Flat,
    /// Mean and covariance over the training images, stored in the weights file.
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

/// The model of depth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FitMethod {
    /// Basis functions alone: the paper's least squares.
    #[default]
    Lse,
    /// A field alone, which is smooth except across edges; earlier versions called it "wls".
    #[serde(alias = "wls")]
    Field,
    /// Both, fitted jointly.
    Joint,
}

impl FitMethod {
    /// All methods.
    pub const ALL: [Self; 3] = [Self::Lse, Self::Field, Self::Joint];

    pub(crate) fn has_field(self) -> bool {
        self != Self::Lse
    }

    /// The name in configs and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Lse => "lse",
            Self::Field => "field",
            Self::Joint => "joint",
        }
    }
}

/// The estimation of the weights of the basis functions; the defaults are the paper's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FitConfig {
    /// The model of depth: "lse" (basis functions, as in the paper), "field" (smooth except across edges) or
    /// "joint" (both).
    pub method: FitMethod,
    /// Settings of the joint fit of basis functions and field.
    pub joint: JointConfig,
    /// Singular values below this fraction of the largest are truncated (paper Algorithm 1). The default is
    /// 129 times the epsilon of f32.
    pub rcond: f64,
    /// Added to the diagonal of the normal equations, as a fraction of their mean diagonal; 0 is the paper's
    /// fit.
    pub ridge: f64,
    /// The prior over the weights: "none", "flat" or "learned". A prior replaces `rcond` and `ridge`.
    pub prior: PriorKind,
    /// The strength of the prior: "evidence", "gcv", a fixed ratio of noise variance to prior variance, or
    /// three pairs of a number of points and such a ratio.
    pub lambda: Lambda,
    /// Unused. Files of versions up to 0.2.0 name the fitted quantity here.
    #[doc(hidden)]
    #[serde(skip_serializing, deserialize_with = "depth_alone")]
    pub space: (),
    /// Settings of a robust fit, which limits the influence of outliers (paper Algorithm 2).
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
            space: (),
            robust: None,
        }
    }
}

/// Settings that replace those stored with the weights, if given.
#[doc(hidden)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Changes {
    /// The model of depth.
    pub method: Option<FitMethod>,
    /// Robustness, or `Some(None)` for a plain fit.
    pub robust: Option<Option<Robust>>,
    /// The prior over the weights.
    pub prior: Option<PriorKind>,
}

impl FitConfig {
    /// These settings with changes. A lambda chosen for basis functions with a field does not apply to basis functions
    /// alone, and vice versa.
    #[doc(hidden)]
    #[must_use]
    pub fn changed(self, changes: &Changes) -> Self {
        let mut fit = self;
        fit.robust = changes.robust.unwrap_or(fit.robust);
        if let Some(method) = changes.method.filter(|&m| m != fit.method) {
            fit.method = method;
            fit.lambda = Lambda::Evidence;
        }
        fit.prior = changes.prior.unwrap_or(fit.prior);
        fit
    }

    /// The solver of one linear problem without a prior.
    #[doc(hidden)]
    pub fn solver(&self) -> Solver {
        if self.ridge > 0.0 {
            Solver::Ridge(self.ridge)
        } else {
            Solver::Truncated(self.rcond)
        }
    }

    /// The highest frequency of the cosine basis that is part of the field.
    #[doc(hidden)]
    pub fn cosines(&self) -> f64 {
        match self.method {
            FitMethod::Joint => self.joint.cosines,
            FitMethod::Lse | FitMethod::Field => 0.0,
        }
    }

    /// The strength of the prior in a fit with a field; that of training if there is no prior.
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
        write!(f, "fit")?;
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
                for (i, (count, lambda)) in values.into_iter().enumerate() {
                    let comma = if i > 0 { "," } else { "" };
                    write!(f, "{comma} {lambda:.2e} at {count}")?;
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
            Some(robust) if robust.loss == Loss::Auto => {
                write!(
                    f,
                    ", points weighted by the probability that they are right"
                )
            }
            Some(robust) => write!(
                f,
                ", {} of up to {} rounds",
                robust.loss.name(),
                robust.iterations
            ),
        }
    }
}

/// Accepts the fitted quantity that files of versions up to 0.2.0 name, if it is depth.
fn depth_alone<'de, D: Deserializer<'de>>(deserializer: D) -> Result<(), D::Error> {
    let space = String::deserialize(deserializer)?;
    if space == "depth" {
        return Ok(());
    }
    Err(D::Error::custom(format!(
        "`space = \"{space}\"` was supported until 0.2.0, now fits are of depth alone"
    )))
}
