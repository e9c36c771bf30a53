//! The cosine basis: smooth functions that do not depend on the image. They represent slopes and curvature
//! between points, which a field of first differences would flatten.

use lsdc_kernels::schedule::InTasks;
use rayon::prelude::*;

/// Cosines over the image, without the constant, up to a frequency that is the same in both directions for an
/// image with an aspect ratio of 4:3.
#[derive(Clone, Debug, PartialEq)]
pub struct CosineBasis {
    /// Numbers of half-waves across and down.
    pairs: Vec<(usize, usize)>,
}

/// Half-waves across and down at frequency 1.
const ACROSS: f64 = 4.0;
const DOWN: f64 = 3.0;
/// Least number of positions per task.
const TOGETHER: usize = 64;

impl CosineBasis {
    /// The functions up to a frequency: none for 0; frequency 1 has up to 4 half-waves across and 3 down.
    pub fn up_to(frequency: f64) -> Self {
        let most = |axis: f64| (frequency * axis).floor() as usize;
        let mut pairs = Vec::new();
        for down in 0..=most(DOWN) {
            for across in 0..=most(ACROSS) {
                let square = (across as f64 / ACROSS).powi(2) + (down as f64 / DOWN).powi(2);
                if square > 0.0 && square <= frequency * frequency {
                    pairs.push((across, down));
                }
            }
        }
        Self { pairs }
    }

    /// The number of functions.
    pub fn len(&self) -> usize {
        self.pairs.len()
    }

    /// Whether there are no functions.
    pub fn is_empty(&self) -> bool {
        self.pairs.is_empty()
    }

    /// The half-waves of each function, across and down.
    pub fn pairs(&self) -> &[(usize, usize)] {
        &self.pairs
    }

    /// The penalty on the square of each weight: like the bending energy of a thin plate (Wahba 1990, section
    /// 2.4), it grows with the fourth power of the frequency; at low frequencies it is `bending`.
    pub fn ridges(&self, bending: f64) -> Vec<f64> {
        let count = |&pair| bending * (1.0 + square(pair)).powi(2);
        self.pairs.iter().map(count).collect()
    }

    /// Appends the values of the cosines to rows of existing values, `before` values for each position.
    /// Positions (u, v) are in pixels of an image of the given height and width, where (0, 0) is the centre
    /// of the first pixel.
    pub fn append_to(
        &self,
        rows: &[f32],
        before: usize,
        (height, width): (usize, usize),
        places: &[[f64; 2]],
    ) -> Vec<f32> {
        let all = before + self.len();
        let mut values = vec![0.0; places.len() * all];
        let parts = values.par_chunks_mut((TOGETHER * all).max(1));
        let parts = parts.zip(places.par_chunks(TOGETHER)).enumerate();
        parts.each(|(part, (values, places))| {
            let [mut across, mut down] = [0, 1].map(|axis| vec![0.0; self.most(axis) + 1]);
            let targets = values.chunks_exact_mut(all.max(1)).zip(places);
            for ((row, &[u, v]), i) in targets.zip(part * TOGETHER..) {
                cosines(u, width, &mut across);
                cosines(v, height, &mut down);
                row[..before].copy_from_slice(&rows[i * before..][..before]);
                for (value, &(p, q)) in row[before..].iter_mut().zip(&self.pairs) {
                    *value = across[p] * down[q];
                }
            }
        });
        values
    }

    /// Adds the weighted sum of the functions at every pixel.
    pub fn add_to(&self, (height, width): (usize, usize), weights: &[f64], values: &mut [f32]) {
        if self.is_empty() {
            return;
        }
        let (across, down) = (self.table(width, 0), self.table(height, 1));
        let most = self.most(0);
        values
            .par_chunks_mut(width)
            .enumerate()
            .each(|(y, values)| {
                let mut sums = vec![0.0_f32; most + 1];
                for (&(p, q), weight) in self.pairs.iter().zip(weights) {
                    sums[p] += *weight as f32 * down[q * height + y];
                }
                for (p, sum) in sums.into_iter().enumerate() {
                    let wave = &across[p * width..][..width];
                    values
                        .iter_mut()
                        .zip(wave)
                        .for_each(|(value, wave)| *value += sum * wave);
                }
            });
    }

    /// The largest number of half-waves across (axis 0) or down (axis 1).
    pub fn most(&self, axis: usize) -> usize {
        let counts = self.pairs.iter().map(|pair| [pair.0, pair.1][axis]);
        counts.max().unwrap_or(0)
    }

    /// The half-waves along an axis of `length` pixels, `[half-waves, length]`.
    pub fn table(&self, length: usize, axis: usize) -> Vec<f32> {
        let count = self.most(axis) + 1;
        let mut table = vec![0.0; count * length];
        let mut values = vec![0.0; count];
        for place in 0..length {
            cosines(place as f64, length, &mut values);
            for (wave, value) in values.iter().enumerate() {
                table[wave * length + place] = *value;
            }
        }
        table
    }
}

/// Every half-wave at a position on an axis, the constant first: from one cosine, by
/// `cos (n + 1) t = 2 cos t cos n t - cos (n - 1) t`, which loses no digit of f32.
fn cosines(place: f64, length: usize, values: &mut [f32]) {
    let first = (std::f64::consts::PI * (place + 0.5) / length as f64).cos();
    let (mut previous, mut current) = (first, 1.0);
    for value in values {
        *value = current as f32;
        (previous, current) = (current, 2.0 * first * current - previous);
    }
}

/// The square of a frequency.
fn square((across, down): (usize, usize)) -> f64 {
    (across as f64 / ACROSS).powi(2) + (down as f64 / DOWN).powi(2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waves_are_counted_by_their_frequency() {
        assert!(CosineBasis::up_to(0.0).is_empty());
        // (p / 4)^2 + (q / 3)^2 <= 1: p = 0 to 4 with q = 0, 3 with q = 1, 2 with q = 2, 0 with q = 3.
        let cosines = CosineBasis::up_to(1.0);
        assert_eq!(cosines.len(), 4 + 4 + 3 + 1);
        // Four half-cosines across have frequency 1: a weight of half the size counts as much as that of a
        // constant.
        let place = cosines
            .pairs
            .iter()
            .position(|&pair| pair == (4, 0))
            .unwrap();
        assert!((cosines.ridges(0.06)[place] - 0.24).abs() < 1e-12);
    }

    #[test]
    fn a_map_is_the_sum_of_its_functions() {
        let cosines = CosineBasis::up_to(2.0);
        let (height, width) = (9, 14);
        let weights: Vec<f64> = (0..cosines.len()).map(|i| (i as f64 * 0.7).sin()).collect();
        let mut map = vec![1.5; height * width];
        cosines.add_to((height, width), &weights, &mut map);
        let pixels = 0..height * width;
        let given: Vec<f32> = pixels.clone().flat_map(|p| [7.0, p as f32]).collect();
        let places: Vec<[f64; 2]> = pixels
            .map(|p| [(p % width) as f64, (p / width) as f64])
            .collect();
        let rows = cosines.append_to(&given, 2, (height, width), &places);
        for (i, row) in rows.chunks(2 + cosines.len()).enumerate() {
            assert_eq!(row[..2], [7.0, i as f32]);
            let (x, y) = ((i % width) as f64, (i / width) as f64);
            let mut sum = 1.5;
            for ((&(p, q), weight), value) in cosines.pairs.iter().zip(&weights).zip(&row[2..]) {
                let turn = |n: usize, at: f64, length: usize| {
                    (std::f64::consts::PI * n as f64 * (at + 0.5) / length as f64).cos()
                };
                let wave = turn(p, x, width) * turn(q, y, height);
                assert!((f64::from(*value) - wave).abs() < 1e-6);
                sum += weight * wave;
            }
            assert!((f64::from(map[i]) - sum).abs() < 1e-5);
        }
    }
}
