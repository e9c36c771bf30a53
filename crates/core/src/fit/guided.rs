//! The trust in a guide: the prior over its weights under which the points are most likely.

use super::lambda::Lambda;
use super::lstsq::Moments;
use super::prior::Prior;
use crate::error::Result;

/// Standard deviations of the weights of the guide's functions, in units of the scene's scale.
const DEVIATIONS: [f64; 3] = [0.1, 0.3, 1.0];
/// Factors of the standard deviations of the network's weights, because the network may add little to the guide.
const SHARES: [f64; 4] = [1.0, 0.5, 0.2, 0.05];
/// Returns the prior over the weights of the network's functions and of `guides` more functions that maximises the likelihood
/// of points with these moments (empirical Bayes), and its deviation for the latter: 0 without evidence for the guide.
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
    // The prior probability of no guide is that of all candidates together.
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
