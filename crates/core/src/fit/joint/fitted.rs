//! Leverages and variances of a joint fit.

use super::coarse::CoarseGrid;
use super::merged_observations::{MergedObservations, SampledObservations};
use super::smoothness::Smoothness;
use super::stacking::{self, StackedResiduals};
use super::surface::left_out;
use crate::bilinear::InterpolationWeights;
use crate::error::FitError;
use crate::field::{CovarianceSolver, PrecisionSolver};
use crate::fit::affinities::SmoothField;
use crate::fit::leave_one_out::leave_one_out;
use crate::fit::lstsq::Solution;
use faer::{Mat, MatRef};

/// A fitted field.
#[derive(Debug)]
pub(in crate::fit) struct FieldFit {
    pub(super) solver: FieldSolver,
    pub(super) smoothness: Smoothness,
    /// Whether the field follows the surface spanned by the observations.
    pub(super) follows_surface: bool,
    /// The residuals of the stacked fits, if the map is made from several.
    pub(super) stacked: Option<StackedResiduals>,
    pub(super) merged: MergedObservations,
    /// The observations from which the weights were estimated.
    pub(super) sample: SampledObservations,
    pub(in crate::fit) smooth: SmoothField,
    pub(in crate::fit) observation_precision: f64,
    /// The penalties on the last weights, those of the cosines.
    pub(in crate::fit) ridges: Vec<f64>,
    /// Number of pixels in holes at which basis functions contradicted the surrounding depths.
    pub(in crate::fit) limited: usize,
}

/// The field of a few or many observations.
#[derive(Debug)]
pub(super) enum FieldSolver {
    Few(CovarianceSolver),
    Many {
        field: PrecisionSolver,
        /// Share of one observation in the total number of determined directions of the weights.
        share: f64,
        /// Field of the sample, from which the covariance of the weights was computed; `None` if it was freed.
        of_sample: Option<CovarianceSolver>,
    },
}

impl FieldFit {
    /// The leverage of each point: its weight times the variance of the fitted depth there.
    pub(in crate::fit) fn leverages(&self, solution: &Solution, weights: &[f64]) -> Vec<f64> {
        self.leverages_of(&self.observation_variances(solution), weights)
    }

    /// Returns the leverages from the variance of the fitted depth at each observation.
    fn leverages_of(&self, variances: &[f64], weights: &[f64]) -> Vec<f64> {
        let pairs = self.merged.of_points().zip(weights);
        let leverage = |(observation, weight): (Option<usize>, &f64)| {
            observation.map_or(0.0, |observation| {
                let weight = weight * self.merged.scale_of(observation);
                (self.observation_precision * weight * variances[observation]).clamp(0.0, 1.0)
            })
        };
        pairs.map(leverage).collect()
    }

    /// Returns the residuals of the map, if they differ from those of the fit.
    pub(in crate::fit) fn map_residuals(&self) -> Option<&[f64]> {
        Some(&self.stacked.as_ref()?.map)
    }

    /// Returns the share of the median of three fits in the map, if the map is stacked.
    pub(in crate::fit) fn median_share(&self) -> Option<f64> {
        Some(self.stacked.as_ref()?.share)
    }

    /// Corrects leave-one-out errors of points with these `values` and weights. They are those of the joint fit for a given
    /// surface, but without an observation the surface also changes, and the map also depends on other fits.
    pub(in crate::fit) fn left_out(&self, values: &[f64], weights: &[f64], errors: &mut [f64]) {
        if !self.follows_surface {
            return;
        }
        let merged = &self.merged;
        let others = left_out(&merged.places, &merged.depths, &merged.firmness());
        let others = merged.of_points().map(|observation| others[observation?]);
        let field_alone = self.stacked.as_ref().map(|stacked| {
            let own = match &self.solver {
                FieldSolver::Few(field) => field.variances(),
                FieldSolver::Many { field, .. } => field.variances(),
            };
            let leverages = self.leverages_of(&own, weights);
            (
                leave_one_out(&stacked.field, &leverages, true),
                stacked.share,
            )
        });
        for (i, (others, error)) in others.zip(errors).enumerate() {
            let Some(others) = others else { continue };
            let (field_error, share) = match &field_alone {
                Some((errors, share)) => (errors[i], *share),
                None => (*error, 0.0),
            };
            let [joint, median] = stacking::errors(values[i], [*error, field_error], others);
            *error = joint + share * (median - joint);
        }
    }

    /// The variance of the fitted depth at each observation.
    fn observation_variances(&self, solution: &Solution) -> Vec<f64> {
        match &self.solver {
            FieldSolver::Few(field) => {
                // Contribution of the weights, at the observations, which precede step terms.
                let along = field.residuals(with_depth(solution.factor.as_ref()).as_ref());
                let variances = field
                    .variances()
                    .into_iter()
                    .take(self.sample.len())
                    .enumerate();
                variances
                    .map(|(i, own)| own + along.row(i).squared_norm_l2())
                    .collect()
            }
            // Each leverage h leaves 1 - h = (1 - h of the field) (1 - share of the weights); the share is the
            // mean of all, as in generalised cross-validation (Golub, Heath and Wahba 1979).
            FieldSolver::Many { field, share, .. } => {
                let variances = field.variances().into_iter().zip(&self.merged.weights);
                let both = |(own, weight): (f64, &f64)| own + share * (weight.recip() - own);
                variances.map(both).collect()
            }
        }
    }

    /// Returns the field of many observations at the position given by `interpolation`, and its variance; 0 for few
    /// observations.
    pub(in crate::fit) fn at(&self, interpolation: &InterpolationWeights) -> (f64, f64) {
        let variance = match &self.solver {
            FieldSolver::Few(_) => 0.0,
            FieldSolver::Many { field, .. } => field.variance(interpolation),
        };
        (self.smooth.read(interpolation), variance)
    }

    /// Variances at every pixel of the field, where the steps between neighbours with affinity 1 have variance 1.
    /// `bases` returns the basis functions and cosines `[places, k]` at positions in an image of the size of the
    /// field.
    ///
    /// # Errors
    /// Equations that are not positive definite.
    pub(in crate::fit) fn variances(
        &self,
        solution: &Solution,
        bases: impl FnOnce(&[[f64; 2]]) -> Vec<f32>,
    ) -> Result<Variances, FitError> {
        let observed;
        let field = match &self.solver {
            FieldSolver::Many { field, .. } => field,
            FieldSolver::Few(_) => {
                let (interpolation, weights) = (&self.merged.interpolation, &self.merged.weights);
                observed = self.smoothness.observed(interpolation, weights)?;
                &observed
            }
        };
        let own = field.pixel_variances();
        let coarse = CoarseGrid::new(self.smooth.size(), FINE);
        let weights = self.added(solution.factor.as_ref(), &coarse, bases)?;
        Ok(Variances {
            size: self.smooth.size(),
            field: own,
            weights: coarse.spread(&weights),
        })
    }

    /// Like [`Self::variances`], for the field of blocks of pixels, and for few observations without the contribution of
    /// cosines, in a fraction of the time.
    ///
    /// # Errors
    /// Equations that are not positive definite.
    pub(in crate::fit) fn rough_variances(
        &self,
        solution: &Solution,
        bases: impl FnOnce(&[[f64; 2]]) -> Vec<f32>,
    ) -> Result<Variances, FitError> {
        let smoothness = self.smoothness.by_block();
        let blocks = self.smoothness.affinities.blocks();
        let interpolation = self
            .merged
            .interpolation
            .iter()
            .map(|interpolation| blocks.interpolation(interpolation));
        let interpolation: Vec<InterpolationWeights> = interpolation.collect();
        let field = smoothness.observed(&interpolation, &self.merged.weights)?;
        let coarse = CoarseGrid::new(self.smooth.size(), ROUGH);
        let factor = solution.factor.as_ref();
        let factor = match self.solver {
            // The last columns are those of the cosines.
            FieldSolver::Few(_) => factor.subcols(0, factor.ncols() - self.ridges.len()),
            FieldSolver::Many { .. } => factor,
        };
        let weights = self.added(factor, &coarse, bases)?;
        Ok(Variances {
            size: blocks.counts(),
            field: field.pixel_variances(),
            weights: coarse.spread_over(&weights, blocks.counts()),
        })
    }

    /// Returns, at pixels of the coarse grid, the variance due to the weights: that of the functions minus the field's
    /// response.
    fn added(
        &self,
        factor: MatRef<'_, f64>,
        coarse: &CoarseGrid,
        bases: impl FnOnce(&[[f64; 2]]) -> Vec<f32>,
    ) -> Result<Vec<f64>, FitError> {
        let recomputed;
        let field = match &self.solver {
            FieldSolver::Few(field)
            | FieldSolver::Many {
                of_sample: Some(field),
                ..
            } => field,
            // The field alone.
            FieldSolver::Many { .. } if self.sample.len() == 0 => {
                return Ok(vec![0.0; coarse.pixels().count()]);
            }
            FieldSolver::Many { .. } => {
                recomputed = self
                    .smoothness
                    .without_step_terms()
                    .covariance_solver(&self.sample)?;
                &recomputed
            }
        };
        let places: Vec<[f64; 2]> = coarse.pixels().map(|(x, y)| [x as f64, y as f64]).collect();
        let pixel = |(x, y): (usize, usize)| {
            InterpolationWeights::pixel((y * self.smooth.size().1 + x) as u32)
        };
        let interpolation: Vec<InterpolationWeights> = coarse.pixels().map(pixel).collect();
        let bases = bases(&places);
        let columns = bases.len() / interpolation.len().max(1);
        let responses = field.at(&interpolation, with_depth(factor).as_ref());
        let rows = Mat::from_fn(interpolation.len(), factor.nrows(), |i, j| {
            f64::from(bases[i * columns + j])
        });
        let along = rows * factor - responses;
        Ok(along.row_iter().map(|row| row.squared_norm_l2()).collect())
    }
}

/// Number of pixels at which the variance due to weights is computed: for the variances, and for features.
const FINE: usize = 1100;
const ROUGH: usize = 300;

/// The posterior variances at the pixels of a field, or at blocks of them, row by row, in the unit of the variance of
/// the step between two neighbours with affinity 1.
#[derive(Clone, Debug)]
pub struct Variances {
    /// Height and width.
    pub size: (usize, usize),
    /// Of the field for known weights.
    pub field: Vec<f64>,
    /// Contribution of basis functions and cosines.
    pub weights: Vec<f64>,
}

/// Returns the columns of a factor with an additional row for the depth, which does not vary.
fn with_depth(factor: MatRef<'_, f64>) -> Mat<f64> {
    Mat::from_fn(factor.nrows() + 1, factor.ncols(), |i, j| {
        if i < factor.nrows() {
            factor[(i, j)]
        } else {
            0.0
        }
    })
}
