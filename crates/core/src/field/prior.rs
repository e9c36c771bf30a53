//! A field before any observation.

use super::factor::{Factor, free_updates};
use super::grid::Grid;
use super::plan::Plan;
use super::stencil::{Connectivity, Stencil};
use std::sync::Arc;

/// The smallest diagonal regularisation of a [`FieldPrior`].
pub const LEAST_REGULARISATION: f64 = 1e-12;

/// A field before any observation: the factor of its equations, which every set of observations shares.
#[derive(Clone, Debug)]
pub struct FieldPrior(pub(super) Arc<Factor>);

impl FieldPrior {
    /// Factorises the equations. `None` if values are not finite, or `diagonal_regularisation` is below
    /// [`LEAST_REGULARISATION`]: the field is then undetermined up to a constant without observations, and the variance of this
    /// constant would drown all others in rounding errors.
    ///
    /// # Panics
    /// If lengths do not match.
    pub fn new(grid: &Grid<'_>) -> Option<Self> {
        grid.check();
        if grid.diagonal_regularisation.is_nan()
            || grid.diagonal_regularisation < LEAST_REGULARISATION
        {
            return None;
        }
        let plan = Plan::of(grid.height, grid.width, Connectivity::Four);
        let factor = Factor::new(plan, &Stencil::new(grid));
        // An image is factorised once; the covariances that follow need as much memory.
        free_updates();
        factor.map(|factor| Self(Arc::new(factor)))
    }
}
