//! The outcome of a fit, and results derived from it in closed form.

use super::SmoothField;
use super::estimate::Estimate;
use super::joint::{FieldFit, Variances};
use super::leave_one_out::{least_freedom, leave_one_out};
use super::lstsq::Solution;
use super::points::FitRows;
use crate::error::FitError;
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatRef, Par};
use std::sync::Arc;

/// The outcome of a fit.
#[derive(Clone, Debug)]
pub struct Fit {
    /// The weights of the basis functions, with the constant first, followed by those of the cosines, in
    /// metres.
    pub weights: Vec<f64>,
    /// Depth minus fitted depth at each point, in metres.
    pub residuals: Vec<f64>,
    /// The weight of each point in the last solve: all 1 in a plain fit without standard deviations.
    pub point_weights: Vec<f64>,
    /// The number of directions that the points determine, at most N + 1.
    pub rank: usize,
    /// The strength of the prior, if there was one: the ratio of the noise variance to the variance of the
    /// prior.
    pub lambda: Option<f64>,
    /// The standard deviation of the prior over the weights of the guide's functions, in units of the scene's scale, if
    /// there is a guide and the prior is learned; 0 if the points do not support the guide.
    pub guide_trust: Option<f64>,
    /// The noise variance of a point of weight 1, in square metres.
    pub(super) noise: f64,
    /// Depths, and residuals of the fit without stacking, in metres.
    pub(super) values: Vec<f64>,
    pub(super) unstacked_residuals: Vec<f64>,
    solution: Solution,
    pub(super) field: Option<Arc<FieldFit>>,
}

impl Fit {
    /// The fit of rows by an estimate with their weights.
    pub(super) fn new(rows: FitRows<'_>, estimate: Estimate, guide_trust: Option<f64>) -> Self {
        let Estimate {
            solution,
            residuals,
            noise,
            lambda,
            field,
        } = estimate;
        let of_map = field.as_ref().and_then(|field| field.map_residuals());
        Self {
            weights: solution.weights.clone(),
            residuals: of_map.unwrap_or(&residuals).to_vec(),
            point_weights: rows.weights,
            rank: solution.rank,
            lambda,
            guide_trust,
            noise,
            values: rows.values,
            unstacked_residuals: residuals,
            solution,
            field,
        }
    }

    /// The number of basis functions, including the constant but not the cosines: an upper bound of the rank.
    pub fn functions(&self) -> usize {
        self.weights.len() - self.field.as_ref().map_or(0, |field| field.ridges.len())
    }

    /// The field that is added to the weighted basis functions, if there is one.
    pub fn smooth(&self) -> Option<&SmoothField> {
        self.field.as_ref().map(|field| &field.smooth)
    }

    /// The number of pixels of the field, in holes of dense depths, at which basis functions contradicted the surrounding
    /// depths and were limited.
    pub fn limited(&self) -> usize {
        self.field.as_ref().map_or(0, |field| field.limited)
    }

    /// The share of the median in the map: 0 is the fit of basis functions and field; 1 is the median of this fit, of the field
    /// alone, and of the surface spanned by the points. `None` for other fits, and if the points span no surface.
    pub fn median_share(&self) -> Option<f64> {
        self.field.as_ref()?.median_share()
    }

    /// Height and width of that field.
    pub(crate) fn field_size(&self) -> Option<(usize, usize)> {
        self.field.as_ref().map(|field| field.smooth.size())
    }

    /// Root mean square of the residuals, in metres.
    pub fn rms(&self) -> f64 {
        root_mean_square(&self.residuals)
    }

    /// The leverage of each point: the influence of its depth on its own fitted value, from 0 to 1. `bases`
    /// are the basis functions that were fitted.
    pub fn leverages(&self, bases: &[f32]) -> Vec<f64> {
        self.leverages_with(|| bases)
    }

    /// The leverages, with basis functions computed only if needed: fits with a field do not need them.
    pub fn leverages_with<B: AsRef<[f32]>>(&self, bases: impl FnOnce() -> B) -> Vec<f64> {
        match &self.field {
            None => self
                .solution
                .leverages(bases().as_ref(), &self.point_weights),
            Some(field) => field.leverages(&self.solution, &self.point_weights),
        }
    }

    /// The leave-one-out error of each point, in metres: its residual if it were left out of the fit, which is the residual
    /// divided by 1 - leverage (Allen 1974). Their root mean square (the PRESS error) estimates the error of the depth between
    /// the points without ground truth, if the points are distributed like the pixels. NaN for a point that the fit
    /// interpolates exactly for any depth.
    pub fn leave_one_out(&self, leverages: &[f64]) -> Vec<f64> {
        let has_field = self.field.is_some();
        let mut errors = leave_one_out(&self.unstacked_residuals, leverages, has_field);
        if let Some(field) = &self.field {
            field.left_out(&self.values, &self.point_weights, &mut errors);
        }
        for (error, leverage) in errors.iter_mut().zip(leverages) {
            if 1.0 - leverage < least_freedom(has_field) {
                *error = f64::NAN;
            }
        }
        errors
    }

    /// The root mean square of leave-one-out errors other than NaN; `None` if there are none.
    pub fn leave_one_out_error(&self, leverages: &[f64]) -> Option<f64> {
        let mut errors = self.leave_one_out(leverages);
        errors.retain(|error| !error.is_nan());
        (!errors.is_empty()).then(|| root_mean_square(&errors))
    }

    /// Whether the fit interpolates all points exactly for any depths, so that they give no information about the noise.
    pub fn is_saturated(&self) -> bool {
        let used = self.point_weights.iter().filter(|w| **w > 0.0).count();
        self.field.is_none() && self.lambda.is_none() && used <= self.rank
    }

    /// The variance of the fitted value for each row of basis functions, for points whose noise has unit
    /// variance. Computed in f32, because there is one row for each pixel.
    pub fn spreads(&self, bases: &[f32]) -> Vec<f32> {
        let k = self.weights.len().max(1);
        let factor = &self.solution.factor;
        let factor = Mat::from_fn(k, factor.ncols(), |i, j| factor[(i, j)] as f32);
        // Transposed, so that the values of a pixel are contiguous.
        let mut product = Mat::<f32>::zeros(factor.ncols(), bases.len() / k);
        let rows = MatRef::from_row_major_slice(bases, bases.len() / k, k);
        let (accum, par) = (Accum::Replace, Par::Seq);
        matmul(
            product.as_mut(),
            accum,
            factor.transpose(),
            rows.transpose(),
            1.0,
            par,
        );
        let columns = product.col_iter();
        columns.map(|column| column.squared_norm_l2()).collect()
    }

    /// The posterior variances at every pixel of the field of a fit; `None` for a fit without a field. `bases`
    /// returns the basis functions `[places, N + 1]` at positions in an image of the given height and width.
    ///
    /// # Errors
    /// Equations that are not positive definite.
    pub fn variances(
        &self,
        bases: impl Fn((usize, usize), &[[f64; 2]]) -> Vec<f32> + Sync,
    ) -> Result<Option<Variances>, FitError> {
        let of = |field: &Arc<FieldFit>| {
            field.variances(&self.solution, |places| bases(field.smooth.size(), places))
        };
        self.field.as_ref().map(of).transpose()
    }

    /// Like [`Self::variances`], but approximately, at blocks of pixels and, for few points, without the contribution of
    /// cosines: features in a fraction of the time.
    ///
    /// # Errors
    /// Equations that are not positive definite.
    pub(crate) fn rough_variances(
        &self,
        bases: impl Fn((usize, usize), &[[f64; 2]]) -> Vec<f32> + Sync,
    ) -> Result<Option<Variances>, FitError> {
        let of = |field: &Arc<FieldFit>| {
            field.rough_variances(&self.solution, |places| bases(field.smooth.size(), places))
        };
        self.field.as_ref().map(of).transpose()
    }

    /// The noise variance of a point of weight 1, in square metres.
    pub fn noise(&self) -> f64 {
        self.noise
    }

    /// The weight of a point of weight 1 in the objective: 1, or `observation_precision` in a fit with a field.
    pub(super) fn observation_precision(&self) -> f64 {
        self.field
            .as_ref()
            .map_or(1.0, |field| field.observation_precision)
    }
}

/// The root mean square.
pub fn root_mean_square(values: &[f64]) -> f64 {
    let sum: f64 = values.iter().map(|v| v * v).sum();
    (sum / values.len().max(1) as f64).sqrt()
}
