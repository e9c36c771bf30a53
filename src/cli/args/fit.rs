//! What is typed to fit otherwise than the weights say.

use super::values::{NamedFit, Robustness, prior_kind, space, typed};
use clap::Args as ClapArgs;
use lsdc_core::fit::{FitConfig, FitMethod, Lambda, PriorKind, Space};

/// Settings of the fit, laid over those of the weights.
#[derive(Clone, Debug, ClapArgs)]
pub(in crate::cli) struct FitFlags {
    /// What depth is made of: lse (the paper's basis functions), field (one that is smooth but for
    /// the image's edges), joint (both) [default: as the weights say].
    #[arg(long = "fit", value_parser = typed::<NamedFit>, value_name = "METHOD", help_heading = "Fit", hide_short_help = true)]
    fit_method: Option<NamedFit>,
    /// Fit without following outliers [default: as the weights say].
    #[arg(long, value_enum, value_name = "LOSS", help_heading = "Fit")]
    robust: Option<Robustness>,
    /// What is assumed before any depth is seen: none (the paper's fit), flat, learned [default: as
    /// the weights say].
    #[arg(long, value_parser = prior_kind(), help_heading = "Fit", hide_short_help = true)]
    prior: Option<PriorKind>,
    /// What basis functions add up to: depth, log, inverse [default: as the weights say].
    #[arg(long, value_parser = space(), help_heading = "Fit", hide_short_help = true)]
    space: Option<Space>,
}

impl FitFlags {
    /// What is said of an old name.
    pub(in crate::cli) fn remark(&self) -> Option<&'static str> {
        self.fit_method?.remark()
    }

    /// Lays the flags over settings. A field is one of depths, and a learned prior one over weights
    /// of depths: in another space basis functions alone and the flat prior take their places. A
    /// lambda that was chosen for basis functions beside a field says nothing of basis functions
    /// alone, and the reverse.
    pub(in crate::cli) fn apply(&self, fit: &mut FitConfig) {
        fit.robust = self.robust.map_or(fit.robust, Robustness::settings);
        fit.space = self.space.unwrap_or(fit.space);
        let alone = (fit.space != Space::Depth).then_some(FitMethod::Lse);
        let chosen = self.fit_method.map(|named| named.method);
        if let Some(method) = chosen.or(alone).filter(|&m| m != fit.method) {
            fit.method = method;
            fit.lambda = Lambda::Evidence;
        }
        if fit.space != Space::Depth && fit.prior == PriorKind::Learned {
            fit.prior = PriorKind::Flat;
        }
        fit.prior = self.prior.unwrap_or(fit.prior);
    }
}
