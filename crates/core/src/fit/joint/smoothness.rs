//! The smoothness of the field of an image, and its combination with observations.

use super::crowded::Crowded;
use super::merged_observations::{MergedObservations, SampledObservations};
use crate::bilinear::InterpolationWeights;
use crate::error::FitError;
use crate::field::{CovarianceSolver, Grid, PrecisionSolver};
use crate::fit::affinities::Affinities;

/// The field of an image before any observation.
#[derive(Clone, Debug)]
pub(super) struct Smoothness {
    pub(super) affinities: Affinities,
    pub(super) regularisation: f64,
    /// Whether [step terms](SmoothnessTerm) are added: if the image is larger than the field.
    pub(super) smooths_steps: bool,
    /// Whether crowded observations are lumped: not in a rough field.
    pub(super) lumped: bool,
}

/// A penalty on the square of the step of the field between two neighbouring pixels that an observation is read from. A
/// point between two pixels belongs to one of them, so that its error is the sum of both squared errors, each by its
/// share, rather than the squared error of the mean: it is larger by the product of the shares and the squared step.
/// Without this term, two points in one cell of the grid, on both sides of an edge that the colours do not show, would
/// force its pixels to extreme values.
#[derive(Clone, Copy, Debug)]
struct SmoothnessTerm {
    one: u32,
    /// The pixel on the right, or below.
    other: u32,
    down: bool,
    weight: f64,
}

impl Smoothness {
    pub(super) fn grid(&self) -> Grid<'_> {
        self.affinities.grid(self.regularisation)
    }

    /// The field with a few observations and their columns.
    ///
    /// # Errors
    /// Equations that are not positive definite.
    pub(super) fn covariance_solver(
        &self,
        sample: &SampledObservations,
    ) -> Result<CovarianceSolver, FitError> {
        let prior = self
            .affinities
            .prior(self.regularisation)
            .ok_or_else(unsolvable)?;
        let terms = self.step_terms(&sample.interpolation, &sample.weights, &Crowded::nowhere());
        let SampledObservations {
            interpolation,
            weights,
            rows,
        } = sample;
        let field = if terms.is_empty() {
            CovarianceSolver::new(&prior, interpolation, weights, rows)
        } else {
            // Terms are further observations, of a step of 0 without basis functions.
            let steps = terms
                .iter()
                .map(|term| InterpolationWeights::difference(term.one, term.other));
            let interpolation: Vec<_> = interpolation.iter().copied().chain(steps).collect();
            let precisions = terms.iter().map(|term| term.weight);
            let weights: Vec<f64> = weights.iter().copied().chain(precisions).collect();
            let zeros = vec![0.0; terms.len() * (sample.columns() + 1)];
            CovarianceSolver::new(
                &prior,
                &interpolation,
                &weights,
                &[&rows[..], &zeros].concat(),
            )
        };
        field.ok_or_else(unsolvable)
    }

    /// The field of blocks of pixels.
    pub(super) fn by_block(&self) -> Self {
        Self {
            affinities: self.affinities.by_block().clone(),
            regularisation: self.regularisation * self.affinities.blocks().area() as f64,
            smooths_steps: self.smooths_steps,
            lumped: false,
        }
    }

    /// Returns this without step terms, which affect the map but not the weights.
    pub(super) fn without_step_terms(&self) -> Self {
        Self {
            smooths_steps: false,
            ..self.clone()
        }
    }

    /// Returns the number of observations and step terms, if no observation is lumped.
    pub(super) fn equations(&self, merged: &MergedObservations) -> Option<usize> {
        let crowded = self.crowded(&merged.interpolation);
        let terms = || {
            self.step_terms(&merged.interpolation, &merged.weights, &crowded)
                .len()
        };
        (!crowded.any()).then(|| merged.len() + terms())
    }

    /// The field with any number of observations.
    ///
    /// # Errors
    /// Equations that are not positive definite.
    pub(super) fn observed(
        &self,
        interpolation: &[InterpolationWeights],
        weights: &[f64],
    ) -> Result<PrecisionSolver, FitError> {
        let grid = self.grid();
        let crowded = self.crowded(interpolation);
        let terms = self.step_terms(interpolation, weights, &crowded);
        let lumped = |observation: usize| crowded.is(observation);
        let field = if terms.is_empty() {
            PrecisionSolver::with_lumped(&grid, interpolation, weights, lumped)
        } else {
            let (mut right, mut down) = (grid.right.to_vec(), grid.down.to_vec());
            for term in terms {
                let along = if term.down { &mut down } else { &mut right };
                along[term.one as usize] += term.weight;
            }
            let stiffened = Grid {
                right: &right,
                down: &down,
                ..grid
            };
            PrecisionSolver::with_lumped(&stiffened, interpolation, weights, lumped)
        };
        field.ok_or_else(unsolvable)
    }

    /// The observations that are lumped.
    fn crowded(&self, interpolation: &[InterpolationWeights]) -> Crowded {
        if self.lumped {
            Crowded::among(interpolation, self.affinities.size())
        } else {
            Crowded::nowhere()
        }
    }

    /// The step terms of the observations that are not lumped.
    fn step_terms(
        &self,
        interpolation: &[InterpolationWeights],
        weights: &[f64],
        crowded: &Crowded,
    ) -> Vec<SmoothnessTerm> {
        /// Weight of the product of shares and squared step, relative to that of the observation. Of 0.001, 0.003, 0.01,
        /// 0.03 and 0.1 on frames of training and of other cameras: with more, edges are less sharp.
        const STEP: f64 = 0.01;
        /// Terms weaker than the affinity of the pixels times this are omitted, because their effect is negligible.
        const RELEVANT: f64 = 4.0;
        let mut terms = Vec::new();
        if !self.smooths_steps {
            return terms;
        }
        let grid = self.grid();
        let alone = interpolation.iter().zip(weights).enumerate();
        for (_, (interpolation, weight)) in
            alone.filter(|(observation, _)| !crowded.is(*observation))
        {
            for (i, (one, share)) in interpolation.iter().enumerate() {
                // In the order of the pixels.
                for (other, across) in interpolation.iter().skip(i + 1) {
                    let down = other as usize == one as usize + grid.width;
                    let beside = other == one + 1 && !(other as usize).is_multiple_of(grid.width);
                    if !down && !beside {
                        continue;
                    }
                    let along = if down { grid.down } else { grid.right };
                    let weight = STEP * weight * share * across;
                    if weight > RELEVANT * along[one as usize] {
                        terms.push(SmoothnessTerm {
                            one,
                            other,
                            down,
                            weight,
                        });
                    }
                }
            }
        }
        terms
    }
}

pub(super) fn unsolvable() -> FitError {
    FitError::Unsolvable("the equations of the field are not positive definite")
}
