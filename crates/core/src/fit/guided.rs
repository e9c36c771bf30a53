//! How far a guide is to be trusted: the prior over its weights that makes the points likeliest.

use super::lambda::Lambda;
use super::lstsq::Moments;
use super::prior::Prior;
use crate::error::Result;

/// Standard deviations of the weights of the guide's functions, in units of the scene's scale.
const DEVIATIONS: [f64; 3] = [0.1, 0.3, 1.0];
/// What those of the network's are multiplied by: it may have little to add.
const SHARES: [f64; 4] = [1.0, 0.5, 0.2, 0.05];
/// The prior over the weights of the network's functions and those of `guides` more that makes points of these moments
/// likeliest (empirical Bayes), and the deviation that it gives the latter: without proof for the guide, 0.
///
/// # Errors
/// A prior for another number of functions, or values that are not finite.
pub(super) fn likeliest(
    prior: &Prior,
    guides: usize,
    moments: &Moments,
    lambda: Lambda,
) -> Result<(Prior, f64)> {
    let mut best = (prior.with_guides(1.0, guides, 0.0), 0.0);
    // No guide is as likely beforehand as all of these together.
    let candidates = SHARES.len() * DEVIATIONS.len();
    let mut least = moments.neg_log_likelihood(&best.0, lambda)? - 2.0 * (candidates as f64).ln();
    for share in SHARES {
        for deviation in DEVIATIONS {
            let candidate = prior.with_guides(share, guides, deviation);
            let neg_log_likelihood = moments.neg_log_likelihood(&candidate, lambda)?;
            if neg_log_likelihood < least {
                (best, least) = ((candidate, deviation), neg_log_likelihood);
            }
        }
    }
    Ok(best)
}
