//! Arguments that override the fit settings stored with the weights.

use super::encoder::EncoderInput;
use super::values::{Robustness, fit_method, prior_kind, quality};
use clap::Args as ClapArgs;
use lsdc_core::Quality;
use lsdc_core::fit::{Changes, FitConfig, FitMethod, PriorKind};

/// Settings of the fit, which override those stored with the weights.
#[derive(Clone, Debug, ClapArgs)]
pub(in crate::cli) struct FitFlags {
    /// Model of depth: lse (basis functions, as in the paper), field (smooth except across edges of
    /// the image), joint (both) [default: as stored with the weights].
    #[arg(long = "fit", value_parser = fit_method(), hide_possible_values = true, value_name = "METHOD", help_heading = "Fit", hide_short_help = true)]
    fit_method: Option<FitMethod>,
    /// Robust loss, which limits the influence of outliers: none, irls, huber, cauchy, gm, tukey or auto [default: as
    /// stored with the weights].
    ///
    /// Use auto: it changes next to nothing where there are no outliers.
    #[arg(
        long,
        value_enum,
        hide_possible_values = true,
        value_name = "LOSS",
        help_heading = "Fit"
    )]
    robust: Option<Robustness>,
    /// Prior over the weights of the basis functions: none (the paper's fit), flat, learned [default: as
    /// stored with the weights].
    #[arg(long, value_parser = prior_kind(), help_heading = "Fit", hide_short_help = true)]
    prior: Option<PriorKind>,
    /// Work per completion: standard, or best (the mean of the completions of the image and of its mirror image, in
    /// twice the time and memory).
    #[arg(long, value_parser = quality(), default_value = "standard", help_heading = "Fit", hide_short_help = true)]
    pub(in crate::cli) quality: Quality,
    #[command(flatten)]
    pub(in crate::cli) encoder: EncoderInput,
}

impl FitFlags {
    /// The flags that were given, but for `--robust none` and `--quality standard`.
    pub(in crate::cli) fn given(&self) -> impl Iterator<Item = &'static str> {
        let robust = self
            .robust
            .is_some_and(|robust| robust.settings().is_some());
        let flags = [
            ("`--fit`", self.fit_method.is_some()),
            ("`--robust`", robust),
            ("`--prior`", self.prior.is_some()),
            ("`--quality`", self.quality != Quality::Standard),
            ("`--encoder-side`", self.encoder.side.is_some()),
        ];
        let given = flags.into_iter().filter(|(_, given)| *given);
        given.map(|(name, _)| name)
    }

    /// The settings that the flags override.
    pub(in crate::cli) fn changes(&self) -> Changes {
        Changes {
            method: self.fit_method,
            robust: self.robust.map(Robustness::settings),
            prior: self.prior,
        }
    }

    /// Overrides settings with the flags.
    pub(in crate::cli) fn apply(&self, fit: &mut FitConfig) {
        *fit = fit.changed(&self.changes());
    }
}
