//! The joint fit of basis functions and field to the points of one image.

use super::JointConfig;
use super::sites::{Sites, UNSOLVABLE};
use crate::error::{FitError, Result};
use crate::field::{Field, Observations, Reach, Spread};
use crate::fit::affinities::{Affinities, Scene, Smooth};
use crate::fit::lstsq::{Moments, Solution};
use crate::fit::points::Rows;
use crate::fit::prior::Prior;
use crate::fit::{Estimate, Lambda};
use faer::{Mat, MatRef, Scale};
use rayon::prelude::*;
use std::sync::Arc;

/// How a field is fitted: with basis functions if there is a prior over their weights.
#[derive(Clone, Copy, Debug)]
pub(in crate::fit) struct FieldEstimator<'a> {
    pub(in crate::fit) scene: Scene<'a>,
    pub(in crate::fit) joint: JointConfig,
    pub(in crate::fit) prior: Option<(&'a Prior, Lambda)>,
    /// The last columns are cosines, with these penalties on the squares of their weights.
    pub(in crate::fit) ridges: &'a [f64],
}

/// A field that was fitted.
#[derive(Debug)]
pub(in crate::fit) struct FieldFit {
    field: Field,
    affinities: Affinities,
    level: f64,
    sites: Sites,
    pub(in crate::fit) smooth: Smooth,
    pub(in crate::fit) size: (usize, usize),
    pub(in crate::fit) data: f64,
    /// The penalties on the last weights, those of the cosines.
    pub(in crate::fit) ridges: Vec<f64>,
}

impl FieldEstimator<'_> {
    pub(in crate::fit) fn solve(self, rows: &Rows<'_>, weights: &[f64]) -> Result<Estimate> {
        let sites = Sites::new(rows, weights, self.scene, &self.joint)?;
        let columns = rows.columns();
        let field = sites.field(self.scene.affinities, self.joint.level, self.ridges)?;
        let freedom = sites.freedom(self.joint.level);
        // Cosines that are not part of the field are marginalised out of the moments.
        let apart = self.ridges.len() - field.functions();
        let moments = moments(&field, columns - field.functions(), freedom);
        let (mut solution, noise, lambda) = match self.prior {
            None => {
                // Rounding may leave less than nothing.
                let noise = moments.square.max(0.0) / moments.count.max(1) as f64;
                (nothing(columns - field.functions()), noise, None)
            }
            Some((prior, lambda)) => {
                let (moments, cosines) = moments.without_last(&self.ridges[..apart])?;
                let found = moments.shrunk(prior, lambda)?;
                let solution = cosines.beside(&found.solution);
                (solution, found.noise, Some(found.lambda))
            }
        };
        let mut rest: Vec<f64> = solution.weights.iter().map(|w| -w).collect();
        rest.push(1.0);
        let (values, cosines) = field.extend(&rest);
        solution.weights.extend(cosines);
        let rests = rows.residuals(&solution.weights);
        let places = rows.places.unwrap_or_default().iter();
        let rests = rests.iter().zip(places).map(|(rest, &place)| {
            rest - self
                .scene
                .affinities
                .taps(place, self.scene.size)
                .read(&values)
        });
        Ok(Estimate {
            rests: rests.collect(),
            solution,
            noise,
            lambda,
            field: Some(Arc::new(FieldFit {
                field,
                affinities: self.scene.affinities.clone(),
                level: self.joint.level,
                sites,
                smooth: Smooth::new(self.scene.affinities.size(), &values),
                size: self.scene.affinities.size(),
                data: self.joint.data,
                ridges: self.ridges.to_vec(),
            })),
        })
    }
}

impl FieldEstimator<'_> {
    /// The covariances of the depths of some points before noise, whose variance is 1 / (data x weight): those of
    /// field, cosines, and basis functions whose prior has the strength `lambda`.
    ///
    /// # Errors
    /// Equations that are not positive definite.
    pub(in crate::fit) fn covariance(
        &self,
        rows: &Rows<'_>,
        which: &[usize],
        lambda: Option<f64>,
    ) -> Result<Mat<f64>> {
        /// The variance of the field in that of the mean of the prior, about whose scale nothing is known.
        const KNOWN: f64 = 1e-3;
        let places = rows.places.unwrap_or_default();
        let columns = rows.columns();
        let taps: Vec<_> = which
            .iter()
            .map(|&i| self.scene.affinities.taps(places[i], self.scene.size))
            .collect();
        let row = |i: usize| &rows.bases[which[i] * columns..][..columns];
        let mut values = Vec::with_capacity(which.len() * (columns + 1));
        for i in 0..which.len() {
            values.extend(row(i).iter().map(|&v| f64::from(v)));
            values.push(0.0);
        }
        let seen = Observations {
            taps: &taps,
            weights: &vec![1.0; taps.len()],
            columns: &values,
            count: columns + 1,
        };
        // A field without a level is as free as one with the least.
        let level = self.joint.level.max(JointConfig::default().level);
        let prior = self.scene.affinities.prior(level);
        let prior = prior.ok_or(FitError::Unsolvable(UNSOLVABLE))?;
        let mut covariance = prior.covariance(&seen, self.ridges);
        if let (Some((prior, _)), Some(lambda)) = (self.prior, lambda) {
            let functions = prior.columns();
            let bases = Mat::from_fn(which.len(), functions, |i, j| f64::from(row(i)[j]));
            let free = &bases * Mat::from_fn(functions, 1, |i, _| prior.mean[i]);
            let middle = |values: &dyn Fn(usize) -> f64| {
                (0..which.len()).map(values).sum::<f64>() / which.len().max(1) as f64
            };
            let square = middle(&|i| free[(i, 0)].powi(2));
            let own = middle(&|i| covariance[(i, i)]);
            let scale = if square > 0.0 {
                own / KNOWN / square
            } else {
                0.0
            };
            let along = bases * &prior.factor;
            covariance += &along * along.transpose() * Scale(lambda.recip())
                + &free * free.transpose() * Scale(scale);
        }
        Ok(covariance)
    }
}

/// The field alone.
fn nothing(columns: usize) -> Solution {
    Solution {
        weights: vec![0.0; columns],
        rank: 0,
        factor: Mat::zeros(columns, 0),
    }
}

/// The field's precision takes the place of the identity in the normal equations (generalised least
/// squares, Aitken 1935).
fn moments(field: &Field, columns: usize, count: usize) -> Moments {
    let all = field.moments();
    Moments {
        normal: Mat::from_fn(columns, columns, |i, j| all[(i.max(j), i.min(j))]),
        right: (0..columns).map(|i| all[(columns, i)]).collect(),
        square: all[(columns, columns)],
        count,
    }
}

impl FieldFit {
    /// The leverage of each point: its weight times the variance of the fitted depth there.
    pub(in crate::fit) fn leverages(&self, solution: &Solution, weights: &[f64]) -> Vec<f64> {
        let stride = solution.weights.len() + 1;
        let mut variances = vec![0.0; self.sites.taps.len()];
        for spread in self.spreads(&self.field, &solution.factor, Reach::Observations) {
            let bases = Mat::from_fn(spread.places.len(), solution.factor.nrows(), |i, j| {
                self.sites.rows[spread.places[i] as usize * stride + j]
            });
            let responses = spread.responses.as_ref();
            let squares = weight_variances(bases.as_ref(), responses, &solution.factor);
            for ((&site, own), square) in spread.places.iter().zip(&spread.variances).zip(squares) {
                variances[site as usize] = own + square;
            }
        }
        let pairs = self.sites.of_points.iter().zip(weights);
        let leverage = |(site, weight): (&Option<usize>, &f64)| {
            site.map_or(0.0, |site| {
                (self.data * weight * variances[site]).clamp(0.0, 1.0)
            })
        };
        pairs.map(leverage).collect()
    }

    /// The variance of the fitted value at every pixel of the field, where the steps between neighbours with
    /// affinity 1 have variance 1. `bases` returns the basis functions `[places, k]` at positions in an image
    /// of the size of the field.
    pub(in crate::fit) fn variances(
        &self,
        solution: &Solution,
        bases: impl Fn(&[[f64; 2]]) -> Vec<f32> + Sync,
    ) -> Result<Vec<f32>, FitError> {
        let columns = solution.weights.len();
        let (field, factor) = self.everywhere(solution)?;
        let spreads = self.spreads(
            field.as_ref().unwrap_or(&self.field),
            &factor,
            Reach::Pixels,
        );
        let parts: Vec<Vec<f64>> = spreads
            .par_iter()
            .map(|spread| {
                let width = self.size.1;
                let place = |&pixel: &u32| [pixel as usize % width, pixel as usize / width];
                let places = spread.places.iter().map(place);
                let places: Vec<_> = places.map(|place| place.map(|v| v as f64)).collect();
                let rows = bases(&places);
                let rows = Mat::from_fn(places.len(), columns, |i, j| {
                    f64::from(rows[i * columns + j])
                });
                let responses = spread.responses.as_ref();
                let squares = weight_variances(rows.as_ref(), responses, &factor);
                let pairs = squares.into_iter().zip(&spread.variances);
                pairs.map(|(square, variance)| square + variance).collect()
            })
            .collect();
        let mut values = vec![0.0; self.size.0 * self.size.1];
        for (spread, part) in spreads.iter().zip(parts) {
            for (&pixel, value) in spread.places.iter().zip(part) {
                values[pixel as usize] = value as f32;
            }
        }
        Ok(values)
    }

    /// The field in a form in which every pixel can be asked for its variance, if that is another one, and the
    /// factor of the covariance of all weights.
    fn everywhere(&self, solution: &Solution) -> Result<(Option<Field>, Mat<f64>), FitError> {
        if self.field.reaches(Reach::Pixels) {
            return Ok((None, solution.factor.clone()));
        }
        let field = self.sites.direct(&self.affinities, self.level)?;
        let moments = moments(&field, solution.weights.len(), self.sites.taps.len());
        let inside = &self.ridges[self.ridges.len() - self.field.functions()..];
        let (_, cosines) = moments.without_last(inside)?;
        let others = Solution {
            weights: solution.weights[..solution.factor.nrows()].to_vec(),
            rank: solution.rank,
            factor: solution.factor.clone(),
        };
        let factor = cosines.beside(&others).factor;
        Ok((Some(field), factor))
    }

    /// Variances, and responses to the columns of a factor of the covariance of the weights.
    fn spreads(&self, field: &Field, factor: &Mat<f64>, reach: Reach) -> Vec<Spread> {
        // The last column is the depth, which does not vary.
        let combinations = Mat::from_fn(factor.nrows() + 1, factor.ncols(), |i, j| {
            if i < factor.nrows() {
                factor[(i, j)]
            } else {
                0.0
            }
        });
        let found = field.spreads(&self.sites.rows, combinations.as_ref(), reach);
        found.unwrap_or_default()
    }
}

/// The contribution of the weights to the variance at each pixel: that of the basis functions minus the
/// field's response to them.
fn weight_variances(
    bases: MatRef<'_, f64>,
    responses: MatRef<'_, f64>,
    factor: &Mat<f64>,
) -> Vec<f64> {
    let along = bases * factor - responses;
    (0..along.nrows())
        .map(|i| along.row(i).squared_norm_l2())
        .collect()
}
