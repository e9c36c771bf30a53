//! Points whose depths come with standard deviations: how much each counts beside what the model of depth
//! leaves unexplained.

use super::estimate::Estimate;
use crate::error::Result;

/// The logarithms of the largest and the smallest variance that may be the root differ by no more than this, when
/// the search ends.
const EXACT: f64 = 1e-7;
/// A search needs a tenth of these.
const ROUNDS: usize = 100;
/// If the points vary no more than their own deviations say, the model explains all the rest: its variance is then
/// this share of that of the most precise point.
const NOTHING: f64 = 1e-6;

/// Weighs points with variances of their own, `own`, which are 0 for points whose variance is unknown: these have that
/// of points about the model in `plain`, the noise of the fit, if others are known. A point whose own variance is v
/// has the weight
///
/// ```text
/// 1 / (1 + data v / s2)
/// ```
///
/// where `s2` / `data` is the variance of the points about the model of depth, of which v is in addition. The model's
/// variance s2 is the one at which the squares of all that the model and the deviations leave to chance have the
/// mean that they are expected to have: at which the estimate of the noise is s2 itself. `plain` is the estimate
/// for points of weight 1; `solve` returns that for other weights.
///
/// # Errors
/// Those of `solve`.
pub(super) fn weighed(
    plain: Estimate,
    own: &[f64],
    data: f64,
    solve: impl Fn(&[f64]) -> Result<Estimate>,
) -> Result<(Estimate, Vec<f64>)> {
    let least = own.iter().copied().filter(|v| *v > 0.0);
    let least = least.fold(f64::INFINITY, f64::min);
    if least == f64::INFINITY {
        return Ok((plain, vec![1.0; own.len()]));
    }
    let unknown = plain.noise / data;
    let at = |place: f64| {
        let square = place.exp();
        let variances = own.iter().map(|&v| if v > 0.0 { v } else { unknown });
        let weights = variances.map(|v| 1.0 / (1.0 + data * v / square));
        let weights: Vec<f64> = weights.collect();
        let estimate = solve(&weights)?;
        // Falls as the place rises.
        let excess = estimate.noise.ln() - place;
        Ok::<_, crate::Error>((excess, estimate, weights))
    };
    let floor = (NOTHING * least).ln();
    // More noise is not left when deviations explain some of it.
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
