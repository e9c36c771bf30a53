//! The joint fit of basis functions and field to the points of one image.

use super::JointConfig;
use super::fitted::{FieldFit, FieldSolver};
use super::holes::Holes;
use super::marginal::determined;
use super::merged_observations::{MergedObservations, Sample};
use super::smoothness::Smoothness;
use super::stacking::{Stack, Stacked, rest_of, stack_few, stack_many};
use super::surface::Surface;
use super::weighed::Weighed;
use crate::error::{FitError, Result};
use crate::field::{self, PrecisionSolver};
use crate::fit::affinities::{Affinities, Scene, Smooth};
use crate::fit::estimate::Estimate;
use crate::fit::lambda::Lambda;
use crate::fit::lstsq::{Moments, Solution, dot};
use crate::fit::points::Rows;
use crate::fit::prior::Prior;
use faer::Mat;
use lsdc_kernels::schedule::join;
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
    /// Whether the field follows the surface that the sites span.
    pub(in crate::fit) surface: bool,
}

/// What is found for some sites.
struct Found {
    solution: Solution,
    noise: f64,
    lambda: Option<f64>,
    /// The field at every pixel, less what basis functions say there.
    values: Vec<f64>,
    /// The fits that it was made from, if there are several.
    stack: Option<Stack>,
    form: FieldSolver,
    smoothness: Smoothness,
    /// Whether the field follows the surface that the sites span.
    follows: bool,
    sample: Sample,
    /// What the weights leave of each point, if that was needed.
    residuals: Option<Vec<f64>>,
    /// Pixels in holes at which basis functions contradicted the depths around.
    limited: usize,
}

/// Weights are estimated from at most so many sites.
const SOME: usize = 700;
/// More sites than this say so much that the surface which they span adds nothing: at 304x228, no pixel is far from one.
const DENSE: usize = 30_000;

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

    /// The same on a coarser grid, of blocks of so many pixels.
    pub(in crate::fit) fn on<'b>(self, blocks: &'b Affinities, area: usize) -> FieldEstimator<'b>
    where
        Self: 'b,
    {
        FieldEstimator {
            scene: Scene {
                affinities: blocks,
                size: self.scene.size,
                upsampling: None,
                once: false,
            },
            joint: JointConfig {
                level: self.joint.level * area as f64,
                ..self.joint
            },
            ..self
        }
    }

    pub(in crate::fit) fn solve(self, rows: &Rows<'_>, weights: &[f64]) -> Result<Estimate> {
        let mut sites = MergedObservations::new(rows, weights, self.scene, &self.joint)?;
        let found = match self.prior {
            None => self.alone(&mut sites, rows)?,
            Some(prior) if self.are_few(&sites) => self.few(&sites, rows, prior)?,
            Some(prior) => self.many(&mut sites, rows, prior)?,
        };
        let rests = found.residuals;
        let rests = rests.unwrap_or_else(|| rows.residuals(&found.solution.weights));
        let places = rows.places.unwrap_or_default();
        let less = |rests: &[f64], values: &[f64]| -> Vec<f64> {
            let pairs = rests.par_iter().zip(places);
            let rests = pairs.map(|(rest, &place)| rest - self.scene.taps(place).read(values));
            rests.collect()
        };
        let rests_of = |stack: Option<Stack>| match stack {
            None => (less(&rests, &found.values), None),
            Some(stack) => {
                let stacked = Stacked {
                    map: less(&rests, &found.values),
                    alone: less(&rows.values, &stack.alone),
                    share: stack.share,
                };
                (less(&rests, &stack.joint), Some(stacked))
            }
        };
        let (rests, stacked) = rests_of(found.stack);
        let size = found.smoothness.affinities.size();
        Ok(Estimate {
            rests,
            solution: found.solution,
            noise: found.noise,
            lambda: found.lambda,
            field: Some(Arc::new(FieldFit {
                form: found.form,
                smoothness: found.smoothness,
                follows: found.follows,
                stacked,
                sites,
                sample: found.sample,
                smooth: Smooth::new(size, &found.values),
                size,
                data: self.joint.data,
                ridges: self.ridges.to_vec(),
                limited: found.limited,
            })),
        })
    }

    /// The moments of some of the points, with field and cosines integrated out, and the number of all.
    pub(in crate::fit) fn some_moments(self, rows: &Rows<'_>) -> Result<(Moments, usize)> {
        let sites = MergedObservations::new(rows, &rows.weights, self.scene, &self.joint)?;
        let sample = sites.sample(SOME, rows)?;
        let field = self.smoothness().untied().covariance_solver(&sample)?;
        let all = moments(field.moments(), sample.columns(), sample.len());
        Ok((all.without_last(self.ridges)?.0, sites.len()))
    }

    /// The surface that sites span, unless there are so many that it would say nothing new, or basis functions are known
    /// at the points only.
    fn surface(self, sites: &MergedObservations, rows: &Rows<'_>) -> Option<Surface> {
        let known = self.prior.is_none() || rows.are_everywhere();
        let size = self.scene.affinities.size();
        (self.surface && known && sites.len() <= DENSE)
            .then(|| Surface::through(&sites.places, &sites.depths, &sites.firmness(), size))
            .flatten()
    }

    /// The field with all sites, and how smooth it is: in perspective, if they span a surface.
    fn observed(
        self,
        sites: &mut MergedObservations,
        surface: Option<&Surface>,
    ) -> Result<(PrecisionSolver, Smoothness), FitError> {
        let mut smoothness = self.smoothness();
        if let Some(surface) = surface {
            let [right, down] = surface.affinities(&smoothness.affinities.grid(smoothness.level));
            let size = smoothness.affinities.size();
            smoothness.affinities = Affinities::from_parts(size, right, down);
            sites.scale(|depth| surface.precision(depth));
        }
        let field = smoothness.observed(&sites.taps, &sites.weights)?;
        Ok((field, smoothness))
    }

    /// The field without basis functions.
    fn alone(self, sites: &mut MergedObservations, rows: &Rows<'_>) -> Result<Found, FitError> {
        let surface = self.surface(sites, rows);
        let (field, smoothness) = self.observed(sites, surface.as_ref())?;
        let right = surface
            .as_ref()
            .map(|surface| surface.pull(&smoothness.affinities.grid(smoothness.level)));
        let values = match right {
            None => field.extend(&sites.depths),
            Some(right) => field.extend_with(&sites.depths, right),
        };
        let square = dot(&sites.depths, &field.pull_from(&sites.depths, &values));
        let columns = rows.columns();
        Ok(Found {
            solution: Solution {
                weights: vec![0.0; columns],
                rank: 0,
                factor: Mat::zeros(columns, 0),
            },
            // Rounding may leave less than nothing.
            noise: square.max(0.0) / sites.len().saturating_sub(1).max(1) as f64,
            lambda: None,
            values,
            stack: None,
            form: FieldSolver::Many {
                field,
                share: 0.0,
                start: None,
            },
            smoothness,
            follows: surface.is_some(),
            sample: sites.sample(0, rows)?,
            residuals: None,
            limited: 0,
        })
    }

    /// The weights from at most so many of the sites, in a field of this smoothness.
    fn weighed(
        self,
        (sites, most): (&MergedObservations, usize),
        rows: &Rows<'_>,
        (prior, lambda): (&Prior, Lambda),
        smoothness: &Smoothness,
    ) -> Result<Weighed> {
        let sample = sites.sample(most, rows)?;
        let field = smoothness.covariance_solver(&sample)?;
        let all = moments(field.moments(), sample.columns(), sample.len());
        // The cosines are a part of the field.
        let (others, cosines) = all.without_last(self.ridges)?;
        let found = others.shrunk(prior, lambda.at(sites.len()))?;
        let solution = cosines.beside(&found.solution);
        Ok(Weighed {
            determined: determined(&others.normal, self.ridges, &solution),
            noise: found.noise,
            lambda: found.lambda,
            solution,
            sample,
            field,
        })
    }

    /// Few sites, from all of which the weights are estimated.
    fn few(
        self,
        sites: &MergedObservations,
        rows: &Rows<'_>,
        prior: (&Prior, Lambda),
    ) -> Result<Found> {
        let smoothness = self.smoothness();
        let (found, surface) = join(
            || self.weighed((sites, sites.len()), rows, prior, &smoothness),
            || self.surface(sites, rows),
        );
        let found = found?;
        let (values, stack) = match &surface {
            None => (found.field.extend(&rest_of(&found.solution.weights)), None),
            Some(surface) => {
                let (values, stack) = stack_few(surface, (sites, rows), &found, &smoothness);
                (values, Some(stack))
            }
        };
        Ok(Found {
            solution: found.solution,
            noise: found.noise,
            lambda: Some(found.lambda),
            values,
            stack,
            form: FieldSolver::Few(found.field),
            smoothness,
            follows: surface.is_some(),
            sample: found.sample,
            residuals: None,
            limited: 0,
        })
    }

    /// The weights from some of the sites, and the field of all.
    fn many(
        self,
        sites: &mut MergedObservations,
        rows: &Rows<'_>,
        prior: (&Prior, Lambda),
    ) -> Result<Found> {
        let untied = self.smoothness().untied();
        let (found, surface) = join(
            || self.weighed((sites, SOME), rows, prior, &untied),
            || self.surface(sites, rows),
        );
        let found = found?;
        let solution = found.solution;
        let mut start = Some(found.field);
        if self.scene.once && sites.len() > DENSE {
            // A field of so many sites is large, and standard deviations, for which the one of some is needed again, are
            // not always asked for.
            start = None;
            self.scene.affinities.forget_prior();
        }
        let (field, smoothness) = self.observed(sites, surface.as_ref())?;
        let residuals = rows.residuals(&solution.weights);
        let targets = sites.means(&residuals);
        let (mut values, stack) = match &surface {
            None => (field.extend(&targets), None),
            Some(surface) => {
                let weights = &solution.weights;
                let (values, stack) = stack_many(
                    surface,
                    (sites, rows),
                    &targets,
                    &field,
                    (weights, &smoothness),
                );
                (values, Some(stack))
            }
        };
        let limited = self.limit_holes(sites, rows, &solution.weights, &field, &mut values);
        Ok(Found {
            solution,
            noise: found.noise,
            lambda: Some(found.lambda),
            values,
            stack,
            form: FieldSolver::Many {
                field,
                share: found.determined / sites.len() as f64,
                start,
            },
            smoothness,
            follows: surface.is_some(),
            sample: found.sample,
            residuals: Some(residuals),
            limited,
        })
    }

    /// Limits what basis functions add in the holes of dense sites. Returns the number of pixels that this changes.
    fn limit_holes(
        self,
        sites: &MergedObservations,
        rows: &Rows<'_>,
        weights: &[f64],
        field: &PrecisionSolver,
        values: &mut [f64],
    ) -> usize {
        let (grid, size) = (self.scene.affinities.size(), self.scene.size);
        let Some(holes) = Holes::new(&sites.taps, &sites.depths, grid, size.0, rows.scale) else {
            return 0;
        };
        let place = |&pixel: &u32| {
            let (x, y) = (pixel as usize % grid.1, pixel as usize / grid.1);
            [rescaled(x, grid.1, size.1), rescaled(y, grid.0, size.0)]
        };
        let places: Vec<[f64; 2]> = holes.pixels().iter().map(place).collect();
        // None where basis functions are known at the points only.
        rows.combine(&places, weights).map_or(0, |functions| {
            holes.limit(&functions, values, || field.extend(&sites.depths))
        })
    }

    fn are_few(self, sites: &MergedObservations) -> bool {
        let few = |count| count <= field::MOST;
        few(sites.len()) && self.smoothness().observations(sites).is_some_and(few)
    }

    fn smoothness(self) -> Smoothness {
        Smoothness {
            affinities: self.scene.affinities.clone(),
            level: self.joint.level,
            tied: self.scene.upsampling.is_some(),
            lumped: true,
        }
    }
}

/// The position of a pixel's centre on an axis of `from` pixels, on one of `to` pixels.
fn rescaled(pixel: usize, from: usize, to: usize) -> f64 {
    (pixel as f64 + 0.5) * to as f64 / from as f64 - 0.5
}

/// The field's precision takes the place of the identity in the normal equations (generalised least
/// squares, Aitken 1935).
pub(super) fn moments(all: &Mat<f64>, columns: usize, count: usize) -> Moments {
    Moments {
        normal: Mat::from_fn(columns, columns, |i, j| all[(i.max(j), i.min(j))]),
        right: (0..columns).map(|i| all[(columns, i)]).collect(),
        square: all[(columns, columns)],
        count,
    }
}
