//! Weights of points with known standard deviations, in addition to the variance that the model of depth leaves unexplained.

use super::estimate::Estimate;
use crate::error::Result;

/// The logarithms of the largest and the smallest variance that may be the root differ by no more than this, when
/// the search ends.
const EXACT: f64 = 1e-7;
/// Upper limit of iterations; a search needs a tenth of it.
const ROUNDS: usize = 100;
/// If the points vary no more than their standard deviations, the variance of the model is this share of that of the
/// most precise point.
const NOTHING: f64 = 1e-6;

/// Weights points by the variances of their measurements, which are 0 where unknown: such points get the noise of the
/// `plain` fit, if other variances are known. A point whose measurement has the variance v has the weight
///
/// ```text
/// 1 / (1 + a v / s2)
/// ```
///
/// where a is the observation precision, and s2 / a the variance of the points about the model of depth, to which v is
/// added. s2 is found as the fixed point at which the fit with these weights estimates a noise of s2. `plain` is the
/// estimate for points of weight 1; `solve` returns that for other weights.
///
/// # Errors
/// The errors of `solve`.
pub(super) fn weighted_by_variance(
    plain: Estimate,
    variances: &[f64],
    observation_precision: f64,
    solve: impl Fn(&[f64]) -> Result<Estimate>,
) -> Result<(Estimate, Vec<f64>)> {
    let least = variances.iter().copied().filter(|v| *v > 0.0);
    let least = least.fold(f64::INFINITY, f64::min);
    if least == f64::INFINITY {
        return Ok((plain, vec![1.0; variances.len()]));
    }
    let unknown = plain.noise / observation_precision;
    let at = |place: f64| {
        let square = place.exp();
        let variances = variances.iter().map(|&v| if v > 0.0 { v } else { unknown });
        let weights = variances.map(|v| 1.0 / (1.0 + observation_precision * v / square));
        let weights: Vec<f64> = weights.collect();
        let estimate = solve(&weights)?;
        // Decreases with `place`.
        let excess = estimate.noise.ln() - place;
        Ok::<_, crate::Error>((excess, estimate, weights))
    };
    let floor = (NOTHING * least).ln();
    // The noise is no larger when the measurements explain some of it.
    let mut high = plain.noise.ln().max(floor);
    let mut found = at(high)?;
    let (mut above, mut step) = (found.0, 2.0);
    let (mut low, mut below) = (high, above);
    while below <= 0.0 && low > floor {
        (high, above) = (low, below);
        low = (low - step).max(floor);
        step *= 2.0;
        found = at(low)?;
        below = found.0;
    }
    if below <= 0.0 {
        return Ok((found.1, found.2));
    }
    // Regula falsi, with the end that stays drawn closer (Illinois; Dowell and Jarratt 1971).
    let mut last = 0;
    for _ in 0..ROUNDS {
        if high - low < EXACT || above >= 0.0 {
            break;
        }
        let share = if above.is_finite() {
            below / (below - above)
        } else {
            0.5
        };
        let place = low + share * (high - low);
        found = at(place)?;
        if found.0.abs() < EXACT {
            break;
        }
        if found.0 > 0.0 {
            (low, below) = (place, found.0);
            if last == 1 {
                above *= 0.5;
            }
            last = 1;
        } else {
            (high, above) = (place, found.0);
            if last == -1 {
                below *= 0.5;
            }
            last = -1;
        }
    }
    Ok((found.1, found.2))
}
