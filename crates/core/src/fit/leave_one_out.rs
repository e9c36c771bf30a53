//! Residuals of points left out of a fit, from their leverages.

/// Residuals divided by 1 - leverage. A point that the fit passes through whatever its depth is gives no
/// information: its residual is 0 / 0, and stays small. A field passes close to every point, up to the
/// influence of the neighbours, which is exact to rounding.
pub(super) fn leave_one_out(residuals: &[f64], leverages: &[f64], field: bool) -> Vec<f64> {
    let least = least_freedom(field);
    let pairs = residuals.iter().zip(leverages);
    pairs.map(|(r, h)| r / (1.0 - h).max(least)).collect()
}

/// A smaller 1 - leverage is rounding error.
pub(super) fn least_freedom(field: bool) -> f64 {
    if field { 1e-9 } else { 1e-3 }
}
