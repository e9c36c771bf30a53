//! Medians, and the deviation that follows from them.

/// The median; 0 without a value.
pub(in crate::fit) fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}

/// The value at which half of the weight is reached; 0 without a value.
pub(super) fn weighted_median(mut pairs: Vec<(f64, f64)>) -> f64 {
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = pairs.iter().map(|p| p.1).sum::<f64>() / 2.0;
    let mut sum = 0.0;
    let reached = pairs.iter().find(|(_, weight)| {
        sum += weight;
        sum >= half
    });
    reached.map_or(0.0, |(value, _)| *value)
}

/// The standard deviation of normal residuals of which up to half are outliers: 1.4826 times the
/// median of their absolute values (Hampel 1974).
pub(super) fn deviation(residuals: &[f64]) -> f64 {
    1.4826 * median(residuals.iter().map(|r| r.abs()))
}
