//! Bilinear interpolation between pixel centres (`align_corners = false`).

/// The two neighbours on an axis of length `from` of pixel `i` on an axis of length `to`, and the
/// weight of the second.
pub(crate) fn neighbours(i: usize, to: usize, from: usize) -> (usize, usize, f32) {
    let position = (i as f64 + 0.5) * (from as f64 / to as f64) - 0.5;
    let position = position.clamp(0.0, (from - 1) as f64);
    let low = position as usize;
    (low, (low + 1).min(from - 1), (position - low as f64) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_lie_between_the_centres_of_others() {
        // Twice as large: pixel 3 has its centre at 3.5 / 2, a quarter of a pixel after centre 1.
        assert_eq!(neighbours(3, 8, 4), (1, 2, 0.25));
        // Beyond the first and the last centre, these hold.
        assert_eq!(neighbours(0, 8, 4), (0, 1, 0.0));
        assert_eq!(neighbours(7, 8, 4), (3, 3, 0.0));
        // Half as large: between two centres.
        assert_eq!(neighbours(1, 2, 4), (2, 3, 0.5));
    }
}
