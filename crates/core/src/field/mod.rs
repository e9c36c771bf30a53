//! A smooth field on a pixel grid, observed at some positions: the minimum of
//!
//! > sum over neighbours c_ij (y_i - y_j)^2 + level sum over pixels y_i^2
//! > + sum over observations a_p (s_p . y - t_p)^2
//!
//! for targets t; s_p interpolates the field bilinearly between the pixels around a position.
//!
//! It is solved directly, by Cholesky factorisation in the order of nested dissection (George 1973), in one of two
//! forms. [`CovarianceSolver`] starts from the factor of the equations without observations ([`FieldPrior`]), which depends
//! on the image alone, and adds observations as covariances: for few of them. [`PrecisionSolver`] factorises the equations
//! with all observations in them: for any number.

mod border;
mod dense;
mod factor;
mod inverse;
mod covariance_solver;
mod precision_solver;
mod plan;
mod runs;
mod stencil;
mod strip;
mod sweep;
#[cfg(test)]
mod tests;
mod symbolic;

pub use covariance_solver::CovarianceSolver;
pub use precision_solver::PrecisionSolver;

use crate::bilinear::InterpolationWeights;
use factor::Factor;
use faer::Mat;
use plan::Plan;
use std::sync::Arc;
use stencil::{Neighbours, Stencil};

/// Gives memory back that is kept for further fields of any size, of this process; what fields in use hold is kept when
/// they are dropped.
pub(crate) fn release() {
    factor::forget_memory();
    plan::forget_plans();
}

/// The affinities of neighbouring pixels, `[height * width]` each, none negative.
#[derive(Clone, Copy, Debug)]
pub struct Grid<'a> {
    /// Number of rows.
    pub height: usize,
    /// Number of columns.
    pub width: usize,
    /// Affinity of each pixel with its right neighbour; the last column is not used.
    pub right: &'a [f64],
    /// Affinity of each pixel with the one below; the last row is not used.
    pub down: &'a [f64],
    /// Strength of the pull of each pixel towards 0; 0 = none.
    pub level: f64,
}

/// The observations of a field.
#[derive(Clone, Copy, Debug)]
pub struct Observations<'a> {
    /// The pixels that each observation is interpolated from.
    pub taps: &'a [InterpolationWeights],
    /// The weight of each observation, above 0.
    pub weights: &'a [f64],
    /// The columns whose combinations are the targets, `[observations, columns]`, row by row.
    pub columns: &'a [f64],
    /// The number of columns.
    pub count: usize,
}

/// With more observations [`CovarianceSolver`], whose cost grows with their square, is not the faster form.
pub const MOST: usize = 1000;

/// The least level of a [`FieldPrior`].
pub const LEAST_LEVEL: f64 = 1e-12;

/// A field before any observation: the factor of its equations, which every set of observations shares.
#[derive(Clone, Debug)]
pub struct FieldPrior(Arc<Factor>);

impl FieldPrior {
    /// Factorises the equations. `None` if values are not finite, or `level` is below [`LEAST_LEVEL`]: the field is
    /// then free by a constant until it is observed, whose variance drowns all others in rounding.
    ///
    /// # Panics
    /// If lengths do not match.
    pub fn new(grid: &Grid<'_>) -> Option<Self> {
        grid.check();
        if grid.level.is_nan() || grid.level < LEAST_LEVEL {
            return None;
        }
        let plan = Plan::of(grid.height, grid.width, Neighbours::Four);
        let factor = Factor::new(plan, &Stencil::new(grid));
        factor.map(|factor| Self(Arc::new(factor)))
    }

    /// The covariances of the field at some positions, noise not included: `[positions, positions]`.
    ///
    /// # Panics
    /// If a pixel is outside the grid.
    pub fn covariance(&self, taps: &[InterpolationWeights]) -> Mat<f64> {
        covariance_solver::covariance(&self.0, taps)
    }
}

impl Grid<'_> {
    fn check(&self) {
        let pixels = self.height * self.width;
        assert_eq!([self.right.len(), self.down.len()], [pixels; 2], "grid");
    }
}

impl Observations<'_> {
    fn check(&self) {
        assert_eq!(self.weights.len(), self.taps.len(), "weights");
        assert_eq!(self.columns.len(), self.taps.len() * self.count, "columns");
    }
}
