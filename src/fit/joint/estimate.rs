//! The fit of one image to its points.

use super::{JointConfig, JointProblem};
use crate::error::{Error, Result};
use crate::field::{Field, Reach, Spread};
use crate::fit::lstsq::{Moments, Solution};
use crate::fit::points::Rows;
use crate::fit::prior::Prior;
use crate::fit::scene::{Scene, Smooth};
use crate::fit::{Estimate, Lambda};
use faer::{Mat, MatRef};
use rayon::prelude::*;
use std::sync::Arc;

/// How a field is fitted: with base functions if there is a prior over their weights.
#[derive(Clone, Copy, Debug)]
pub(in crate::fit) struct FieldEstimator<'a> {
    pub(in crate::fit) scene: Scene<'a>,
    pub(in crate::fit) joint: JointConfig,
    pub(in crate::fit) prior: Option<(&'a Prior, Lambda)>,
    /// The last columns are of waves, and their weights count so much.
    pub(in crate::fit) ridges: &'a [f64],
}

/// A field that was fitted.
#[derive(Debug)]
pub(in crate::fit) struct FieldFit {
    field: Field,
    sites: Sites,
    pub(in crate::fit) smooth: Smooth,
    pub(in crate::fit) size: (usize, usize),
    pub(in crate::fit) data: f64,
    /// How many of the last weights are of waves.
    pub(in crate::fit) waves: usize,
}

/// Points as the field sees them: those of one of its pixels are one.
#[derive(Debug)]
struct Sites {
    pixels: Vec<u32>,
    /// The site of each point, unless the point has no weight.
    of_points: Vec<Option<usize>>,
    weights: Vec<f64>,
    /// Base functions and depth, averaged.
    rows: Vec<f64>,
}

impl FieldEstimator<'_> {
    pub(in crate::fit) fn solve(self, rows: &Rows<'_>, weights: &[f64]) -> Result<Estimate> {
        let sites = Sites::new(rows, weights, self.scene, &self.joint)?;
        let columns = rows.columns();
        let field = sites.field(self.scene, self.joint.level)?;
        let freedom = sites.freedom(self.joint.level);
        let moments = moments(&field, columns, freedom);
        let (solution, noise, lambda) = match self.prior {
            None => {
                let noise = moments.square / moments.count.max(1) as f64;
                (nothing(columns), noise, None)
            }
            Some((prior, lambda)) => {
                let (moments, waves) = moments.without_last(self.ridges)?;
                let found = moments.shrunk(prior, lambda)?;
                let solution = waves.beside(&found.solution);
                (solution, found.noise, Some(found.lambda))
            }
        };
        let mut rest: Vec<f64> = solution.weights.iter().map(|w| -w).collect();
        rest.push(1.0);
        let values = field.extend(&rest);
        let rests = rows.residuals(&solution.weights);
        let places = rows.places.unwrap_or_default().iter();
        let rests = rests.iter().zip(places).map(|(rest, &place)| {
            let pixel = self.scene.edges.pixel(place, self.scene.size);
            rest - values[pixel as usize]
        });
        Ok(Estimate {
            rests: rests.collect(),
            solution,
            noise,
            lambda,
            field: Some(Arc::new(FieldFit {
                field,
                sites,
                smooth: Smooth::new(self.scene.edges.size(), &values),
                size: self.scene.edges.size(),
                data: self.joint.data,
                waves: self.ridges.len(),
            })),
        })
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
        let columns = solution.weights.len();
        let mut site = vec![usize::MAX; self.size.0 * self.size.1];
        for (i, &pixel) in self.sites.pixels.iter().enumerate() {
            site[pixel as usize] = i;
        }
        let mut variances = vec![0.0; self.sites.pixels.len()];
        for spread in self.spreads(solution, Reach::Points) {
            let seen: Vec<usize> = (0..spread.pixels.len())
                .filter(|&i| site[spread.pixels[i] as usize] != usize::MAX)
                .collect();
            let sites: Vec<usize> = seen
                .iter()
                .map(|&i| site[spread.pixels[i] as usize])
                .collect();
            let bases = Mat::from_fn(seen.len(), columns, |i, j| {
                self.sites.rows[sites[i] * (columns + 1) + j]
            });
            let responses = Mat::from_fn(seen.len(), spread.responses.ncols(), |i, j| {
                spread.responses[(seen[i], j)]
            });
            let squares = weight_variances(bases.as_ref(), responses.as_ref(), solution);
            for ((&i, site), square) in seen.iter().zip(sites).zip(squares) {
                variances[site] = spread.variances[i] + square;
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

    /// The variance of the fitted value at every pixel of the field, for a field whose steps
    /// between equal neighbours have variance 1. `bases` gives the base functions of pixels
    /// `[pixels, k]`.
    pub(in crate::fit) fn variances(
        &self,
        solution: &Solution,
        bases: impl Fn(&[u32]) -> Vec<f32> + Sync,
    ) -> Vec<f32> {
        let columns = solution.weights.len();
        let spreads = self.spreads(solution, Reach::All);
        let parts: Vec<Vec<f64>> = spreads
            .par_iter()
            .map(|spread| {
                let rows = bases(&spread.pixels);
                let rows = Mat::from_fn(spread.pixels.len(), columns, |i, j| {
                    f64::from(rows[i * columns + j])
                });
                let squares = weight_variances(rows.as_ref(), spread.responses.as_ref(), solution);
                let pairs = squares.into_iter().zip(&spread.variances);
                pairs.map(|(square, variance)| square + variance).collect()
            })
            .collect();
        let mut values = vec![0.0; self.size.0 * self.size.1];
        for (spread, part) in spreads.iter().zip(parts) {
            for (&pixel, value) in spread.pixels.iter().zip(part) {
                values[pixel as usize] = value as f32;
            }
        }
        values
    }

    fn spreads(&self, solution: &Solution, reach: Reach) -> Vec<Spread> {
        let factor = &solution.factor;
        // The last column is the depth, which does not vary.
        let combinations = Mat::from_fn(factor.nrows() + 1, factor.ncols(), |i, j| {
            if i < factor.nrows() {
                factor[(i, j)]
            } else {
                0.0
            }
        });
        self.field.spreads(combinations.as_ref(), reach)
    }
}

/// The variance at each pixel that the weights add: that of base functions less the field's
/// response to them.
fn weight_variances(
    bases: MatRef<'_, f64>,
    responses: MatRef<'_, f64>,
    solution: &Solution,
) -> Vec<f64> {
    let along = bases * &solution.factor - responses;
    (0..along.nrows())
        .map(|i| along.row(i).squared_norm_l2())
        .collect()
}

impl Sites {
    fn field(&self, scene: Scene<'_>, level: f64) -> Result<Field> {
        let problem = JointProblem {
            grid: scene.edges.grid(level),
            pixels: &self.pixels,
            weights: &self.weights,
            rows: &self.rows,
        };
        problem.field().ok_or_else(|| {
            Error::fit("the field cannot be solved").hint("edges or depths are not finite")
        })
    }

    /// Points, less the one that a level that is free takes.
    fn freedom(&self, level: f64) -> usize {
        self.pixels.len() - usize::from(level == 0.0 && !self.pixels.is_empty())
    }

    fn new(
        rows: &Rows<'_>,
        weights: &[f64],
        scene: Scene<'_>,
        joint: &JointConfig,
    ) -> Result<Self> {
        let places = rows.places.ok_or_else(|| {
            Error::fit("a field cannot be fitted to points whose places are unknown")
        })?;
        let columns = rows.columns();
        let width = columns + 1;
        let mut order: Vec<(u32, usize)> = places
            .iter()
            .enumerate()
            .filter(|(i, _)| weights[*i] > 0.0)
            .map(|(i, &place)| (scene.edges.pixel(place, scene.size), i))
            .collect();
        order.sort_unstable();
        let mut sites = Self {
            pixels: Vec::new(),
            of_points: vec![None; places.len()],
            weights: Vec::new(),
            rows: Vec::with_capacity(order.len() * width),
        };
        for points in order.chunk_by(|a, b| a.0 == b.0) {
            let total: f64 = points.iter().map(|&(_, i)| weights[i]).sum();
            let start = sites.rows.len();
            sites.rows.resize(start + width, 0.0);
            for &(_, i) in points {
                sites.of_points[i] = Some(sites.pixels.len());
                let share = weights[i] / total;
                let row = &rows.bases[i * columns..][..columns];
                let sums = &mut sites.rows[start..];
                for (sum, &value) in sums.iter_mut().zip(row) {
                    *sum += share * f64::from(value);
                }
                sums[columns] += share * rows.values[i];
            }
            sites.pixels.push(points[0].0);
            sites.weights.push(joint.data * total);
        }
        Ok(sites)
    }
}
