//! Student's t distribution, for any number of degrees of freedom above 0.

use std::f64::consts::PI;

/// The share of normal errors that one standard deviation holds.
pub const ONE_DEVIATION: f64 = 0.682_689_492;

/// The probability that |t| is below `bound`.
pub fn within(bound: f64, freedom: f64) -> f64 {
    let square = bound * bound;
    1.0 - incomplete_beta(freedom / (freedom + square), 0.5 * freedom, 0.5)
}

/// The bound that |t| is below with probability `level`, from 0 to 1 (exclusive).
pub fn bound(level: f64, freedom: f64) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    while within(high, freedom) < level && high < f64::MAX.sqrt() {
        (low, high) = (high, 2.0 * high);
    }
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if within(middle, freedom) < level {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

/// Minus the logarithm of the density at t, given t^2.
pub fn neg_log_likelihood(square: f64, freedom: f64) -> f64 {
    let half = 0.5 * (freedom + 1.0);
    log_gamma(0.5 * freedom) - log_gamma(half)
        + 0.5 * (freedom * PI).ln()
        + half * (square / freedom).ln_1p()
}

/// `I_x(a, b)` by its continued fraction (Abramowitz and Stegun 26.5.8), evaluated as Lentz did (1976).
fn incomplete_beta(x: f64, a: f64, b: f64) -> f64 {
    const TINY: f64 = 1e-300;
    const ROUNDS: usize = 500;
    if x <= 0.0 || x >= 1.0 {
        return x.clamp(0.0, 1.0);
    }
    // Where the fraction converges quickly.
    if x > (a + 1.0) / (a + b + 2.0) {
        return 1.0 - incomplete_beta(1.0 - x, b, a);
    }
    let apart = |v: f64| if v.abs() < TINY { TINY } else { v };
    let mut d = 1.0 / apart(1.0 - (a + b) * x / (a + 1.0));
    let (mut c, mut value) = (1.0, d);
    for m in 1..=ROUNDS {
        let m = m as f64;
        let even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
        let odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
        let mut step = 1.0;
        for term in [even, odd] {
            d = 1.0 / apart(1.0 + term * d);
            c = apart(1.0 + term / c);
            step = d * c;
            value *= step;
        }
        if (step - 1.0).abs() < f64::EPSILON {
            break;
        }
    }
    let front = log_gamma(a + b) - log_gamma(a) - log_gamma(b) + a * x.ln() + b * (1.0 - x).ln();
    front.exp() * value / a
}

/// ln Gamma(x) for x > 0, by Stirling's series (Abramowitz and Stegun 6.1.41) after recurrence to x >= 10.
fn log_gamma(x: f64) -> f64 {
    let (mut x, mut product) = (x, 1.0);
    while x < 10.0 {
        product *= x;
        x += 1.0;
    }
    let square = 1.0 / (x * x);
    let series = (1.0 / 12.0
        - square
            * (1.0 / 360.0 - square * (1.0 / 1260.0 - square * (1.0 / 1680.0 - square / 1188.0))))
        / x;
    (x - 0.5) * x.ln() - x + 0.5 * (2.0 * PI).ln() + series - product.ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Abramowitz and Stegun, table 26.10; the distribution of Cauchy has freedom 1.
    #[test]
    fn bounds_are_those_of_published_tables() {
        for (level, freedom, expected) in [
            (0.95, 1.0, 12.706),
            (0.95, 2.0, 4.303),
            (0.95, 3.0, 3.182),
            (0.99, 5.0, 4.032),
            (0.9, 10.0, 1.812),
            (0.95, 4.0, 2.776),
            (0.95, 9.0, 2.262),
            (0.95, 10.0, 2.228),
            (0.95, 30.0, 2.042),
            (0.95, 120.0, 1.980),
            (0.5, 1.0, 1.0),
        ] {
            let found = bound(level, freedom);
            assert!(
                (found - expected).abs() < 6e-4,
                "{level} {freedom}: {found}"
            );
        }
        // Normal in the limit.
        assert!((within(1.0, 1e6) - 0.682_689_5).abs() < 1e-6);
    }

    /// Freedom 2 has a closed form: P(|t| < x) = x / sqrt(2 + x^2); so has 1.
    #[test]
    fn probabilities_have_closed_forms_at_two_degrees() {
        for x in [1e-3_f64, 0.3, 1.0, 4.0, 1e3] {
            let (two, one) = (x / (2.0 + x * x).sqrt(), 2.0 / PI * x.atan());
            assert!((within(x, 2.0) - two).abs() < 1e-12, "{x}");
            assert!((within(x, 1.0) - one).abs() < 1e-12, "{x}");
        }
        // Between whole numbers, the density is the derivative.
        let (x, freedom, step) = (1.3, 2.7, 1e-5);
        let slope = (within(x + step, freedom) - within(x - step, freedom)) / (4.0 * step);
        assert!((slope.ln() + neg_log_likelihood(x * x, freedom)).abs() < 1e-8);
    }
}
