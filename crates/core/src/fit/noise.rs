//! Local noise: the deviation of depths from the fit around each pixel.

use super::window::Window;
use super::{Fit, root_mean_square};
use crate::bilinear::between;

/// The variance of depths about a fit, which varies across the image, because what basis functions cannot
/// represent is large in some areas and small in others. Around a pixel, it is the sum of squared residuals
/// divided by their degrees of freedom, both under a Gaussian window about as wide as the distance between
/// points, and shrunk towards the variance of the whole image with a weight of one degree of freedom.
#[derive(Clone, Debug)]
pub struct LocalNoise {
    /// Variances in square metres, at the centres of square cells.
    values: Vec<f64>,
    columns: usize,
    rows: usize,
    side: f64,
    /// The mean square of the values that were fitted.
    square: f64,
}

impl LocalNoise {
    /// The local noise of a fit to points at `places` (x, y) of an image of `size` (height, width);
    /// `leverages` are those of the fit.
    pub fn new(
        fit: &Fit,
        leverages: &[f64],
        places: &[[f64; 2]],
        (height, width): (usize, usize),
    ) -> Self {
        /// Standard deviation of the window, in mean distances between points.
        const WINDOW: f64 = 0.75;
        /// Least degrees of freedom above rounding errors.
        const LEAST: f64 = 1e-9;
        /// Cells per standard deviation.
        const FINENESS: f64 = 4.0;
        let area = (height * width) as f64;
        let window = WINDOW * (area / places.len().max(1) as f64).sqrt();
        let side = (window / FINENESS).max(1.0);
        let cells = |length: usize| ((length as f64 / side).ceil() as usize).max(1);
        let (columns, rows) = (cells(width), cells(height));
        let mut squares = vec![0.0; columns * rows];
        let mut freedom = vec![0.0; columns * rows];
        let cell = |v: f64, count: usize| (((v + 0.5).max(0.0) / side) as usize).min(count - 1);
        for (i, &[x, y]) in places.iter().enumerate() {
            let at = cell(y, rows) * columns + cell(x, columns);
            let weight = fit.observation_precision() * fit.point_weights[i];
            // Points without weight have no influence on the noise.
            if weight == 0.0 {
                continue;
            }
            let left = 1.0 - leverages[i];
            if fit.field.is_none() {
                squares[at] += weight * fit.unstacked_residuals[i].powi(2);
                freedom[at] += left;
            } else if left > LEAST {
                // A field nearly interpolates every point, which leaves almost no degrees of freedom; its leave-one-out error
                // counts as one degree.
                squares[at] += weight * fit.unstacked_residuals[i].powi(2) / left;
                freedom[at] += 1.0;
            }
        }
        let window = Window::new(window / side);
        let (squares, freedom) = (
            window.sums(&squares, columns),
            window.sums(&freedom, columns),
        );
        let pairs = squares.iter().zip(&freedom);
        Self {
            values: pairs.map(|(s, f)| (s + fit.noise) / (f + 1.0)).collect(),
            columns,
            rows,
            side,
            square: root_mean_square(&fit.values).powi(2),
        }
    }

    /// Whether the noise is zero somewhere: there it is unknown.
    pub fn is_unknown(&self) -> bool {
        const ROUNDING: f64 = 1e-20;
        let least = ROUNDING * self.square;
        self.values.iter().any(|v| *v <= least)
    }

    /// The variance at a position, with coordinates from 0 to the image's width and height; bilinear between
    /// cells.
    pub fn at(&self, x: f64, y: f64) -> f64 {
        let (left, right, across) = between(x / self.side - 0.5, self.columns);
        let (top, bottom, down) = between(y / self.side - 0.5, self.rows);
        let row = |r: usize| {
            let value = |c: usize| self.values[r * self.columns + c];
            value(left) + across * (value(right) - value(left))
        };
        row(top) + down * (row(bottom) - row(top))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::{FitConfig, FitPoints, fit};

    /// A constant fitted to points, exact on the left half and off by `noise` on the right.
    fn halves(noise: f32) -> (Fit, Vec<[f64; 2]>, Vec<f32>) {
        let mut places = Vec::new();
        let mut depths = Vec::new();
        for y in (2..40_u8).step_by(4) {
            for x in (2..80_u8).step_by(4) {
                places.push([f64::from(x), f64::from(y)]);
                let sign = if (x + y) / 4 % 2 == 0 { 1.0 } else { -1.0 };
                depths.push(2.0 + if x < 40 { 0.0 } else { sign * noise });
            }
        }
        let bases = vec![1.0; depths.len()];
        let fit = fit(
            &FitPoints::new(&bases, &depths),
            &FitConfig::default(),
            None,
        )
        .unwrap();
        (fit, places, bases)
    }

    #[test]
    fn the_noise_is_where_the_residuals_are() {
        let (fit, places, bases) = halves(0.5);
        let noise = LocalNoise::new(&fit, &fit.leverages(&bases), &places, (40, 80));
        let right = noise.at(60.0, 20.0).sqrt();
        assert!((right - 0.5).abs() < 0.03, "{right}");
        // Shrunk towards the noise of the whole image, 0.35, by one degree of freedom among 4.5.
        let left = noise.at(20.0, 20.0).sqrt();
        assert!((left - 0.35 / 4.5_f64.sqrt()).abs() < 0.01, "{left}");
    }

    #[test]
    fn a_window_is_the_sum_over_points() {
        let (fit, places, bases) = halves(0.3);
        let leverages = fit.leverages(&bases);
        let noise = LocalNoise::new(&fit, &leverages, &places, (40, 80));
        // One point to 16 pixels: cells of a pixel, a window of 3.
        let (mut squares, mut freedom) = (fit.noise, 1.0);
        for (i, [x, y]) in places.iter().enumerate() {
            let square = (x - 50.0).powi(2) + (y - 17.0).powi(2);
            let weight = (-square / (2.0 * 9.0)).exp();
            squares += weight * fit.unstacked_residuals[i].powi(2);
            freedom += weight * (1.0 - leverages[i]);
        }
        let expected = squares / freedom;
        let found = noise.at(50.5, 17.5);
        assert!(
            (found - expected).abs() < 2e-3 * expected,
            "{found} {expected}"
        );
    }
}
