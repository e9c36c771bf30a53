//! The joint fit of basis functions and field to the points of one image.

use super::JointConfig;
use super::fitted::{FieldFit, FieldSolver};
use super::holes::Holes;
use super::marginal::determined;
use super::merged_observations::{MergedObservations, SampledObservations};
use super::smoothness::Smoothness;
use super::stacking::{Stack, StackedResiduals, residual_combination, stack_few, stack_many};
use super::surface::Surface;
use super::weight_estimate::WeightEstimate;
use crate::bilinear::rescaled;
use crate::error::{Error, FitError, Result};
use crate::field::{self, CovarianceSolver, PrecisionSolver};
use crate::fit::affinities::{Affinities, FieldGeometry, SmoothField};
use crate::fit::estimate::Estimate;
use crate::fit::lambda::Lambda;
use crate::fit::lstsq::{Moments, Solution, dot};
use crate::fit::points::FitRows;
use crate::fit::prior::Prior;
use faer::Mat;
use lsdc_kernels::schedule::{InTasks, join};
use rayon::prelude::*;
use std::sync::Arc;

/// Estimator of a field, with basis functions if there is a prior over their weights.
#[derive(Clone, Copy, Debug)]
pub(in crate::fit) struct FieldEstimator<'a> {
    pub(in crate::fit) geometry: FieldGeometry<'a>,
    pub(in crate::fit) joint: JointConfig,
    pub(in crate::fit) prior: Option<(&'a Prior, Lambda)>,
    /// The last columns are cosines, with these penalties on the squares of their weights.
    pub(in crate::fit) ridges: &'a [f64],
    /// Whether the field follows the surface that the observations span.
    pub(in crate::fit) surface: bool,
}

/// A joint fit to merged observations, before its residuals are computed.
struct JointSolution {
    solution: Solution,
    noise: f64,
    lambda: Option<f64>,
    /// The field at every pixel, without the basis functions.
    values: Vec<f64>,
    /// The stacked fits, if there are several.
    stack: Option<Stack>,
    solver: FieldSolver,
    smoothness: Smoothness,
    /// Whether the field follows the surface spanned by the observations.
    follows_surface: bool,
    sample: SampledObservations,
    /// The residuals of basis functions x weights, if they were needed.
    residuals: Option<Vec<f64>>,
    /// Number of pixels in holes at which basis functions contradicted the surrounding depths.
    limited: usize,
}

/// Weights are estimated from at most this many observations.
const SAMPLE: usize = 700;
/// Largest number of observations for which the surface is used: at 304x228, more leave no pixel far from one.
const DENSE: usize = 30_000;

/// Points per task.
const TOGETHER: usize = 1 << 10;

impl FieldEstimator<'_> {
    /// The field alone.
    pub(in crate::fit) fn without_functions(self) -> Self {
        Self {
            prior: None,
            ridges: &[],
            surface: false,
            ..self
        }
    }

    /// Returns the estimator on a coarser grid, of blocks with this number of pixels.
    pub(in crate::fit) fn on<'b>(self, blocks: &'b Affinities, area: usize) -> FieldEstimator<'b>
    where
        Self: 'b,
    {
        FieldEstimator {
            geometry: FieldGeometry {
                affinities: blocks,
                size: self.geometry.size,
                upsampling: None,
                transient: false,
            },
            joint: JointConfig {
                diagonal_regularisation: self.joint.diagonal_regularisation * area as f64,
                ..self.joint
            },
            ..self
        }
    }

    pub(in crate::fit) fn solve(self, rows: &FitRows<'_>, weights: &[f64]) -> Result<Estimate> {
        let mut merged = MergedObservations::new(rows, weights, self.geometry, &self.joint)?;
        let found = match self.prior {
            None => self.fit_field_alone(&mut merged, rows)?,
            Some(prior) if self.are_few(&merged) => self.fit_few(&merged, rows, prior)?,
            Some(prior) => self.fit_many(&mut merged, rows, prior)?,
        };
        let without_field = found.residuals;
        let without_field =
            without_field.unwrap_or_else(|| rows.residuals(&found.solution.weights));
        let places = rows.places.unwrap_or_default();
        // Each point is located once: of the map, of the joint fit and of the field alone.
        let of_point = |i: usize, place: [f64; 2]| {
            let interpolation = self.geometry.interpolation(place);
            let (rest, read) = (without_field[i], |field: &[f64]| interpolation.read(field));
            let map = rest - read(&found.values);
            found.stack.as_ref().map_or([map; 3], |stack| {
                [
                    map,
                    rest - read(&stack.joint),
                    rows.values[i] - read(&stack.field),
                ]
            })
        };
        let parts = places.par_chunks(TOGETHER).enumerate();
        let parts: Vec<Vec<[f64; 3]>> = parts.gather(|(part, places)| {
            let points = (part * TOGETHER..).zip(places);
            points.map(|(i, &place)| of_point(i, place)).collect()
        });
        let of = |fit: usize| parts.iter().flatten().map(|all| all[fit]).collect();
        let stacked = found.stack.as_ref().map(|stack| StackedResiduals {
            map: of(0),
            field: of(2),
            share: stack.share,
        });
        let residuals = of(1);
        let size = found.smoothness.affinities.size();
        Ok(Estimate {
            residuals,
            solution: found.solution,
            noise: found.noise,
            lambda: found.lambda,
            field: Some(Arc::new(FieldFit {
                solver: found.solver,
                smoothness: found.smoothness,
                follows_surface: found.follows_surface,
                stacked,
                merged,
                sample: found.sample,
                smooth: SmoothField::new(size, &found.values),
                observation_precision: self.joint.observation_precision,
                ridges: self.ridges.to_vec(),
                limited: found.limited,
            })),
        })
    }

    /// The moments of a sample of the points, with field and cosines integrated out, and the number of all.
    pub(in crate::fit) fn sample_moments(self, rows: &FitRows<'_>) -> Result<(Moments, usize)> {
        let merged = MergedObservations::new(rows, &rows.weights, self.geometry, &self.joint)?;
        let sample = merged.sample(SAMPLE, rows)?;
        let field = self
            .smoothness()
            .without_step_terms()
            .covariance_solver(&sample)?;
        let all = moments(field.moments(), sample.columns(), sample.len());
        Ok((all.without_last(self.ridges)?.0, merged.len()))
    }

    /// Returns the surface spanned by the observations; `None` if there are so many that it adds nothing, or basis functions
    /// are known at the points only.
    fn surface(self, merged: &MergedObservations, rows: &FitRows<'_>) -> Option<Surface> {
        let known = self.prior.is_none() || rows.everywhere().is_some();
        let size = self.geometry.affinities.size();
        (self.surface && known && merged.len() <= DENSE)
            .then(|| Surface::through(&merged.places, &merged.depths, &merged.firmness(), size))
            .flatten()
    }

    /// The field with all observations, and how smooth it is: in perspective, if they span a surface.
    fn observed(
        self,
        merged: &mut MergedObservations,
        surface: Option<&Surface>,
    ) -> Result<(PrecisionSolver, Smoothness), FitError> {
        let mut smoothness = self.smoothness();
        if let Some(surface) = surface {
            let [right, down] = surface.affinities(&smoothness.grid());
            let size = smoothness.affinities.size();
            smoothness.affinities = Affinities::from_parts(size, right, down);
            merged.scale(|depth| surface.precision(depth));
        }
        let field = smoothness.observed(&merged.interpolation, &merged.weights)?;
        Ok((field, smoothness))
    }

    /// The field without basis functions.
    fn fit_field_alone(
        self,
        merged: &mut MergedObservations,
        rows: &FitRows<'_>,
    ) -> Result<JointSolution, FitError> {
        let surface = self.surface(merged, rows);
        let (field, smoothness) = self.observed(merged, surface.as_ref())?;
        let values = match &surface {
            None => field.extend(&merged.depths),
            Some(surface) => {
                let targets = merged.depths.as_chunks::<1>().0;
                let right_side = surface.right_side(&smoothness.grid());
                field.extend_with(targets, right_side).into_flattened()
            }
        };
        let square = dot(&merged.depths, &field.pull_from(&merged.depths, &values));
        let columns = rows.columns();
        Ok(JointSolution {
            solution: Solution {
                weights: vec![0.0; columns],
                rank: 0,
                factor: Mat::zeros(columns, 0),
            },
            // Rounding may make it negative.
            noise: square.max(0.0) / merged.len().saturating_sub(1).max(1) as f64,
            lambda: None,
            values,
            stack: None,
            solver: FieldSolver::Many {
                field,
                share: 0.0,
                of_sample: None,
            },
            smoothness,
            follows_surface: surface.is_some(),
            sample: merged.sample(0, rows)?,
            // All weights are 0.
            residuals: Some(rows.values.clone()),
            limited: 0,
        })
    }

    /// The weights from a sample of `count` observations, in a field of this smoothness, and the field of the sample.
    fn estimate_weights(
        self,
        (sample, count): (SampledObservations, usize),
        (prior, lambda): (&Prior, Lambda),
        smoothness: &Smoothness,
    ) -> Result<(WeightEstimate, CovarianceSolver)> {
        let field = smoothness.covariance_solver(&sample)?;
        let all = moments(field.moments(), sample.columns(), sample.len());
        // The cosines are a part of the field.
        let (others, cosines) = all.without_last(self.ridges)?;
        let found = others.shrunk(prior, lambda.at(count))?;
        let solution = cosines.extended(&found.solution);
        let estimate = WeightEstimate {
            determined: determined(&others.normal, self.ridges, &solution),
            noise: found.noise,
            lambda: found.lambda,
            solution,
            sample,
        };
        Ok((estimate, field))
    }

    /// Fits few observations; the weights are estimated from all of them.
    fn fit_few(
        self,
        merged: &MergedObservations,
        rows: &FitRows<'_>,
        prior: (&Prior, Lambda),
    ) -> Result<JointSolution> {
        let smoothness = self.smoothness();
        let (found, surface) = join(
            || {
                let sample = merged.sample(merged.len(), rows)?;
                self.estimate_weights((sample, merged.len()), prior, &smoothness)
            },
            || self.surface(merged, rows),
        );
        let (found, field) = found?;
        let (values, stack) = match &surface {
            None => {
                let combination = residual_combination(&found.solution.weights);
                (field.extend(&combination), None)
            }
            Some(surface) => {
                let (values, stack) =
                    stack_few(surface, (merged, rows), (&found, &field), &smoothness);
                (values, Some(stack))
            }
        };
        Ok(JointSolution {
            solution: found.solution,
            noise: found.noise,
            lambda: Some(found.lambda),
            values,
            stack,
            solver: FieldSolver::Few(field),
            smoothness,
            follows_surface: surface.is_some(),
            sample: found.sample,
            residuals: None,
            limited: 0,
        })
    }

    /// Fits many observations; the weights are estimated from some of them.
    fn fit_many(
        self,
        merged: &mut MergedObservations,
        rows: &FitRows<'_>,
        prior: (&Prior, Lambda),
    ) -> Result<JointSolution> {
        let plain = self.smoothness().without_step_terms();
        let count = merged.len();
        let sample = merged.sample(SAMPLE, rows)?;
        let estimate = || {
            let (found, field) = self.estimate_weights((sample, count), prior, &plain)?;
            let residuals = rows.residuals(&found.solution.weights);
            Ok::<_, Error>((found, field, residuals))
        };
        let observe = |merged: &mut MergedObservations| {
            let surface = self.surface(merged, rows);
            let (field, smoothness) = self.observed(merged, surface.as_ref())?;
            Ok::<_, Error>((surface, field, smoothness))
        };
        let (found, of_sample, residuals, observed) = if self.geometry.transient && count > DENSE {
            // The field of many observations is large, and only standard deviations use the field of the sample again.
            let (found, _, residuals) = estimate()?;
            self.geometry.affinities.drop_prior();
            (found, None, residuals, observe(merged))
        } else {
            // Both are independent.
            let (estimated, observed) = join(estimate, || observe(merged));
            let (found, field, residuals) = estimated?;
            (found, Some(field), residuals, observed)
        };
        let (surface, field, smoothness) = observed?;
        let solution = found.solution;
        let targets = merged.means(&residuals);
        let (mut values, stack) = match &surface {
            None => (field.extend(&targets), None),
            Some(surface) => {
                let weights = &solution.weights;
                let (values, stack) = stack_many(
                    surface,
                    (merged, rows),
                    &targets,
                    &field,
                    (weights, &smoothness),
                );
                (values, Some(stack))
            }
        };
        let limited = self.limit_holes(merged, rows, &solution.weights, &field, &mut values);
        Ok(JointSolution {
            solution,
            noise: found.noise,
            lambda: Some(found.lambda),
            values,
            stack,
            solver: FieldSolver::Many {
                field,
                share: found.determined / merged.len() as f64,
                of_sample,
            },
            smoothness,
            follows_surface: surface.is_some(),
            sample: found.sample,
            residuals: Some(residuals),
            limited,
        })
    }

    /// Limits what basis functions add in the holes of dense observations. Returns the number of pixels that this changes.
    fn limit_holes(
        self,
        merged: &MergedObservations,
        rows: &FitRows<'_>,
        weights: &[f64],
        field: &PrecisionSolver,
        values: &mut [f64],
    ) -> usize {
        let (grid, size) = (self.geometry.affinities.size(), self.geometry.size);
        let Some(holes) = Holes::new(&merged.interpolation, &merged.depths, grid, size.0) else {
            return 0;
        };
        let place = |&pixel: &u32| {
            let (x, y) = (pixel as usize % grid.1, pixel as usize / grid.1);
            [
                rescaled(x as f64, grid.1, size.1),
                rescaled(y as f64, grid.0, size.0),
            ]
        };
        let places: Vec<[f64; 2]> = holes.pixels().iter().map(place).collect();
        rows.everywhere().map_or(0, |functions| {
            let functions = functions.combine(&places, weights);
            holes.limit(&functions, values, || field.extend(&merged.depths))
        })
    }

    fn are_few(self, merged: &MergedObservations) -> bool {
        let few = |count| count <= field::MOST;
        few(merged.len()) && self.smoothness().equations(merged).is_some_and(few)
    }

    fn smoothness(self) -> Smoothness {
        Smoothness {
            affinities: self.geometry.affinities.clone(),
            regularisation: self.joint.diagonal_regularisation,
            smooths_steps: self.geometry.upsampling.is_some(),
            lumped: true,
        }
    }
}

/// The field's precision replaces the identity in the normal equations (generalised least squares, Aitken 1935).
pub(super) fn moments(all: &Mat<f64>, columns: usize, count: usize) -> Moments {
    Moments {
        normal: Mat::from_fn(columns, columns, |i, j| all[(i.max(j), i.min(j))]),
        rhs: (0..columns).map(|i| all[(columns, i)]).collect(),
        square: all[(columns, columns)],
        count,
    }
}
