//! Medians, and the standard deviation derived from them.

/// The median; 0 without a value.
pub(crate) fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Largest number of values that are sorted.
const FEW: usize = 32;

/// Returns the value at which half of the weight is reached; 0 without values.
pub(super) fn weighted_median(mut pairs: Vec<(f64, f64)>) -> f64 {
    let half = pairs.iter().map(|p| p.1).sum::<f64>() / 2.0;
    let mut pairs = &mut pairs[..];
    let mut sum = 0.0;
    // Continue with the half of the values that contains the weighted median, until few are left.
    while pairs.len() > FEW {
        let middle = pairs.len() / 2;
        pairs.select_nth_unstable_by(middle, |a, b| a.0.total_cmp(&b.0));
        let (low, high) = pairs.split_at_mut(middle);
        let below: f64 = low.iter().map(|p| p.1).sum();
        if sum + below >= half {
            pairs = low;
        } else {
            sum += below;
            pairs = high;
        }
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
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
