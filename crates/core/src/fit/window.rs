//! Sums and means over maps under a Gaussian window.

use lsdc_kernels::simd::Level;
use rayon::prelude::*;

/// A Gaussian window, truncated at four standard deviations.
#[derive(Clone, Debug)]
pub(crate) struct Window {
    /// `exp(-x^2 / 2 sd^2)` for x = 0, 1, ...
    weights: Vec<f64>,
}

impl Window {
    /// With this standard deviation in pixels.
    pub(crate) fn new(deviation: f64) -> Self {
        let reach = (4.0 * deviation).ceil() as usize;
        let weight = |x: usize| (-0.5 * (x as f64 / deviation).powi(2)).exp();
        Self {
            weights: (0..=reach).map(weight).collect(),
        }
    }

    /// The sum around each pixel of rows of `width` values, which are 0 beyond the border.
    pub(crate) fn sums(&self, values: &[f64], width: usize) -> Vec<f64> {
        let (height, reach) = (values.len() / width.max(1), self.weights.len() - 1);
        let mut sums = vec![0.0; values.len()];
        let level = Level::here();
        let rows = sums.par_chunks_mut(width.max(1)).enumerate();
        rows.for_each_init(
            || vec![0.0; width + 2 * reach],
            |row, (y, sums)| {
                let others = y.saturating_sub(reach)..(y + reach + 1).min(height);
                let values = &values[others.start * width..others.end * width];
                let first = reach + others.start - y;
                level.vectorised(
                    #[inline(always)]
                    || self.row(values, first, row, sums),
                );
            },
        );
        sums
    }

    /// Computes the sums around the pixels of a row, from the rows around it: vertically first, then horizontally. `first` is
    /// the position in the window of the first of these rows.
    #[inline(always)]
    fn row(&self, values: &[f64], first: usize, row: &mut [f64], sums: &mut [f64]) {
        let (width, reach) = (sums.len(), self.weights.len() - 1);
        row.fill(0.0);
        for (values, place) in values.chunks_exact(width).zip(first..) {
            let weight = self.weights[place.abs_diff(reach)];
            let pairs = row[reach..].iter_mut().zip(values);
            pairs.for_each(|(sum, value)| *sum += weight * value);
        }
        for offset in 0..=2 * reach {
            let weight = self.weights[offset.abs_diff(reach)];
            let pairs = sums.iter_mut().zip(&row[offset..]);
            pairs.for_each(|(sum, value)| *sum += weight * value);
        }
    }

    /// The mean around each pixel under the part of the window that is inside the map.
    pub(crate) fn means(&self, values: &[f64], width: usize) -> Vec<f64> {
        let height = values.len() / width.max(1);
        let mut means = self.sums(values, width);
        let (across, down) = (
            self.sums(&vec![1.0; width], width),
            self.sums(&vec![1.0; height], height),
        );
        for (row, down) in means.chunks_exact_mut(width.max(1)).zip(down) {
            for (mean, across) in row.iter_mut().zip(&across) {
                *mean /= across * down;
            }
        }
        means
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_and_means_are_those_of_all_pairs_of_pixels() {
        let (width, height, deviation) = (9, 6, 1.3_f64);
        let value = |i: usize| (i as f64 * 1.7).sin() + 2.0;
        let values: Vec<f64> = (0..width * height).map(value).collect();
        let window = Window::new(deviation);
        let (sums, means) = (window.sums(&values, width), window.means(&values, width));
        for pixel in 0..values.len() {
            let (mut sum, mut share) = (0.0, 0.0);
            for (other, value) in values.iter().enumerate() {
                let x = (other % width).abs_diff(pixel % width) as f64;
                let y = (other / width).abs_diff(pixel / width) as f64;
                if x.max(y) <= (4.0 * deviation).ceil() {
                    let weight = (-(x * x + y * y) / (2.0 * deviation * deviation)).exp();
                    sum += weight * value;
                    share += weight;
                }
            }
            assert!((sums[pixel] - sum).abs() < 1e-12 * sum, "{pixel}");
            assert!((means[pixel] - sum / share).abs() < 1e-12, "{pixel}");
        }
        assert!(window.means(&[], 0).is_empty());
    }
}
