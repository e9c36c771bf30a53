//! A smooth field on a pixel grid, observed at some positions: the minimum of
//!
//! > sum over neighbours c_ij (y_i - y_j)^2 + e sum over pixels y_i^2
//! > + sum over observations a_p (s_p . y - t_p)^2
//!
//! for targets t and the regularisation e of the diagonal; s_p interpolates the field bilinearly between the pixels around
//! a position.
//!
//! It is solved directly, by Cholesky factorisation in the order of nested dissection (George 1973), in one of two
//! forms. [`CovarianceSolver`] starts from the factor of the equations without observations ([`FieldPrior`]), which depends
//! on the image alone, and adds observations as covariances: for few of them. [`PrecisionSolver`] factorises the equations
//! with all observations in them: for any number.

mod border;
mod covariance_solver;
mod dense;
mod factor;
mod grid;
mod inverse;
mod plan;
mod precision_solver;
mod prior;
mod runs;
mod stencil;
mod strip;
mod sweep;
mod symbolic;
#[cfg(test)]
mod tests;

pub use covariance_solver::CovarianceSolver;
pub use grid::Grid;
pub use precision_solver::PrecisionSolver;
pub use prior::{FieldPrior, LEAST_REGULARISATION};

/// Frees the buffers cached by this process for further fields of any size. The buffers of fields in use return to the cache
/// when they are dropped.
pub(crate) fn release() {
    factor::free_memory();
    plan::free_plans();
}

/// Largest number of observations for which [`CovarianceSolver`] is the faster form, because its cost grows with their square.
pub const MOST: usize = 1000;
