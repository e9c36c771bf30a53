//! Fits with a prior, which need only a few points.

use super::lambda::Lambda;
use super::lstsq::Moments;
use super::prior::Prior;
use super::reduced::{Reduced, Shrunk};
use super::spectrum::Spectrum;
use crate::error::Error;

impl Moments {
    /// Solves the problem with a prior over its weights.
    ///
    /// # Errors
    /// Values that are not finite, or a prior for another number of weights.
    pub(super) fn shrunk(&self, prior: &Prior, lambda: Lambda) -> Result<Shrunk, Error> {
        let reduced = Reduced::new(self, prior)?;
        let given = lambda.given(self.count);
        // The singular directions take many times as long.
        if let Some(found) = given.and_then(|lambda| reduced.solved(lambda)) {
            return Ok(found);
        }
        let spectrum = Spectrum::new(&reduced)?;
        Ok(spectrum.shrunk(given.unwrap_or_else(|| spectrum.chosen(lambda))))
    }

    /// -2 ln p(depths | prior) for a strength of the prior, up to a constant that is the same for all priors.
    ///
    /// # Errors
    /// As for [`Self::shrunk`].
    pub(super) fn neg_log_likelihood(&self, prior: &Prior, lambda: Lambda) -> Result<f64, Error> {
        let reduced = Reduced::new(self, prior)?;
        let spectrum = Spectrum::new(&reduced)?;
        let given = lambda.given(self.count);
        Ok(spectrum.neg_log_likelihood(given.unwrap_or_else(|| spectrum.chosen(lambda))))
    }
}
