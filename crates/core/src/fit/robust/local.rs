//! Predictions of points by the nearest others, from covariances.

use super::mixture::{Predict, Predictions};
use crate::error::Result;
use crate::nearest::NeighbourGrid;
use faer::Mat;
use rayon::prelude::*;

/// Number of nearest points in a prediction; they screen the influence of farther points.
const NEAREST: usize = 16;

/// Points with the covariances of each and its nearest others.
#[derive(Debug)]
pub(super) struct LocalKriging<'a> {
    values: &'a [f64],
    points: Vec<Surroundings>,
}

/// The nearest others of a point.
#[derive(Debug)]
struct Surroundings {
    nearest: Vec<usize>,
    /// Covariance of the nearest points, lower half, row by row.
    covariance: Vec<f64>,
    /// Covariance of the point with the nearest points.
    across: Vec<f64>,
    /// Variance of the point.
    variance: f64,
}

impl<'a> LocalKriging<'a> {
    /// From points with these `values`; each is in one of the `blocks`, and is predicted by others in its block. `covariance`
    /// computes the covariances of the values of a block before noise.
    ///
    /// # Errors
    /// The errors of `covariance`.
    pub(super) fn new(
        values: &'a [f64],
        places: &[[f64; 2]],
        blocks: &[Vec<usize>],
        covariance: impl Fn(&[usize]) -> Result<Mat<f64>> + Sync,
    ) -> Result<Self> {
        let surroundings = |block: &Vec<usize>| {
            let own: Vec<[f64; 2]> = block.iter().map(|&i| places[i]).collect();
            let found = Surroundings::all(&own, &covariance(block)?);
            Ok(block
                .iter()
                .copied()
                .zip(found.into_iter().map(|mut point| {
                    for j in &mut point.nearest {
                        *j = block[*j];
                    }
                    point
                }))
                .collect())
        };
        let found: Result<Vec<Vec<(usize, Surroundings)>>> =
            blocks.par_iter().map(surroundings).collect();
        let mut points: Vec<(usize, Surroundings)> = found?.into_iter().flatten().collect();
        points.sort_by_key(|(i, _)| *i);
        Ok(Self {
            values,
            points: points.into_iter().map(|(_, point)| point).collect(),
        })
    }
}

impl Predict for LocalKriging<'_> {
    fn predict(&self, noise: &[f64]) -> Result<Predictions> {
        let pairs = self.points.par_iter().zip(self.values);
        let found = pairs.map(|(point, value)| {
            let (prediction, variance) = point.predict(self.values, noise);
            (value - prediction, variance)
        });
        let (errors, variances) = found.unzip();
        Ok(Predictions { errors, variances })
    }
}

impl Surroundings {
    /// Returns the surroundings of all points at these positions, with the covariances of their values.
    fn all(places: &[[f64; 2]], covariance: &Mat<f64>) -> Vec<Self> {
        let cells = NeighbourGrid::new(places);
        let around = |(i, place): (usize, &[f64; 2])| {
            let found = cells.nearest(*place, NEAREST + 1).into_iter();
            let others = found.map(|(_, j)| j).filter(|&j| j != i);
            let nearest: Vec<usize> = others.take(NEAREST).collect();
            let rows = nearest.iter().enumerate();
            let row = |(k, &j): (usize, &usize)| {
                nearest[..=k]
                    .iter()
                    .map(move |&other| covariance[(j, other)])
            };
            Self {
                covariance: rows.flat_map(row).collect(),
                across: nearest.iter().map(|&j| covariance[(i, j)]).collect(),
                variance: covariance[(i, i)],
                nearest,
            }
        };
        places.par_iter().enumerate().map(around).collect()
    }

    /// The expected value of the point, and its variance, given noisy values of the nearest others (simple
    /// kriging).
    fn predict(&self, values: &[f64], noise: &[f64]) -> (f64, f64) {
        /// Share of a variance that may be rounding error.
        const ROUNDING: f64 = 1e-12;
        let n = self.nearest.len();
        let start = |i: usize| i * (i + 1) / 2;
        let mut lower = [0.0; NEAREST * (NEAREST + 1) / 2];
        let (mut from, mut across) = ([0.0; NEAREST], [0.0; NEAREST]);
        let (mut prediction, mut variance) = (0.0, self.variance);
        // The Cholesky factor row by row, and with it both right-hand sides.
        for i in 0..n {
            let (done, row) = lower.split_at_mut(start(i));
            for j in 0..=i {
                let sum: f64 = if j < i {
                    let other = &done[start(j)..][..j];
                    row[..j].iter().zip(other).map(|(a, b)| a * b).sum()
                } else {
                    row[..j].iter().map(|a| a * a).sum()
                };
                let own = self.covariance[start(i) + j];
                row[j] = if j < i {
                    (own - sum) / done[start(j) + j]
                } else {
                    let noise = noise[self.nearest[i]];
                    (own + noise - sum).max(ROUNDING * own).sqrt()
                };
            }
            let solved = |given: f64, before: &[f64]| {
                let sum: f64 = row[..i].iter().zip(before).map(|(a, b)| a * b).sum();
                (given - sum) / row[i]
            };
            from[i] = solved(values[self.nearest[i]], &from[..i]);
            across[i] = solved(self.across[i], &across[..i]);
            prediction += from[i] * across[i];
            variance -= across[i] * across[i];
        }
        (prediction, variance.max(ROUNDING * self.variance))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use faer::Side;
    use faer::linalg::solvers::Solve as _;

    #[test]
    fn predictions_are_what_is_left_out_of_the_inverse() {
        // So few points that all of them predict each one.
        const N: usize = 9;
        let place = |i: usize| {
            [
                (i % 3) as f64 * 4.0,
                (i / 3) as f64 * 3.0 + (i as f64).sin(),
            ]
        };
        let places: Vec<[f64; 2]> = (0..N).map(place).collect();
        let covariance = Mat::from_fn(N, N, |i, j| {
            let [a, b] = [places[i], places[j]];
            2.0 * (-((a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)) / 40.0).exp()
        });
        let values: Vec<f64> = (0..N).map(|i| (i as f64 * 1.7).cos()).collect();
        let noise: Vec<f64> = (0..N).map(|i| 0.1 + i as f64 * 0.05).collect();
        let block: Vec<usize> = (0..N).collect();
        let found = LocalKriging::new(&values, &places, &[block], |_| Ok(covariance.clone()))
            .unwrap()
            .predict(&noise)
            .unwrap();

        let mut all = covariance.clone();
        (0..N).for_each(|i| all[(i, i)] += noise[i]);
        let inverse = all
            .llt(Side::Lower)
            .unwrap()
            .solve(Mat::<f64>::identity(N, N));
        let pull = &inverse * Mat::from_fn(N, 1, |i, _| values[i]);
        for i in 0..N {
            let own = inverse[(i, i)];
            assert!((found.errors[i] - pull[(i, 0)] / own).abs() < 1e-9);
            assert!((found.variances[i] + noise[i] - 1.0 / own).abs() < 1e-9);
        }
    }
}
