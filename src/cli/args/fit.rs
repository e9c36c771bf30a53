//! What is typed to fit otherwise than the weights say.

use super::values::{Robustness, fit_method, prior_kind, space};
use clap::Args as ClapArgs;
use lsdc_core::fit::{FitConfig, FitMethod, Lambda, PriorKind, Space};

/// Settings of the fit, laid over those of the weights.
#[derive(Clone, Debug, ClapArgs)]
pub(in crate::cli) struct FitFlags {
    /// What depth is made of: lse (the paper's base functions), wls (a field that is smooth but for
    /// the image's edges), joint (both) [default: as the weights say].
    #[arg(long = "fit", value_parser = fit_method(), value_name = "METHOD")]
    fit_method: Option<FitMethod>,
    /// Fit without following outliers [default: as the weights say].
    #[arg(long, value_enum, value_name = "LOSS")]
    robust: Option<Robustness>,
    /// What is assumed before any depth is seen: none (the paper's fit), flat, learned [default: as
    /// the weights say].
    #[arg(long, value_parser = prior_kind())]
    prior: Option<PriorKind>,
    /// What base functions add up to: depth, log, inverse [default: as the weights say].
    #[arg(long, value_parser = space())]
    space: Option<Space>,
}

impl FitFlags {
    /// Lays the flags over settings. A field is one of depths, and a learned prior one over weights
    /// of depths: in another space base functions alone and the flat prior take their places. A
    /// lambda that was chosen for base functions beside a field says nothing of base functions
    /// alone, and the reverse.
    pub(in crate::cli) fn apply(&self, fit: &mut FitConfig) {
        fit.robust = self.robust.map_or(fit.robust, Robustness::settings);
        fit.space = self.space.unwrap_or(fit.space);
        let alone = (fit.space != Space::Depth).then_some(FitMethod::Lse);
        if let Some(method) = self.fit_method.or(alone).filter(|&m| m != fit.method) {
            fit.method = method;
            fit.lambda = Lambda::Evidence;
        }
        if fit.space != Space::Depth && fit.prior == PriorKind::Learned {
            fit.prior = PriorKind::Flat;
        }
        fit.prior = self.prior.unwrap_or(fit.prior);
    }
}
