//! Leave-one-out residuals from leverages.

/// Returns residuals divided by 1 - leverage. A point that the fit interpolates exactly for any depth gives no information: its
/// residual is 0 / 0, and stays small. A field nearly interpolates every point, except for the influence of the neighbours,
/// which is exact to rounding.
pub(super) fn leave_one_out(residuals: &[f64], leverages: &[f64], field: bool) -> Vec<f64> {
    let least = least_freedom(field);
    let pairs = residuals.iter().zip(leverages);
    pairs.map(|(r, h)| r / (1.0 - h).max(least)).collect()
}

/// Returns the least 1 - leverage that is not rounding error.
pub(super) fn least_freedom(field: bool) -> f64 {
    if field { 1e-9 } else { 1e-3 }
}
