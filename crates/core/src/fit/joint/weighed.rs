//! The weights of a joint fit, and what they were estimated from.

use super::merged_observations::Sample;
use crate::field::CovarianceSolver;
use crate::fit::lstsq::Solution;

/// The weights of basis functions and cosines.
pub(super) struct Weighed {
    pub(super) solution: Solution,
    pub(super) noise: f64,
    pub(super) lambda: f64,
    /// What the sites determine of the weights, in directions.
    pub(super) determined: f64,
    /// The sites that they were estimated from, and the field of these.
    pub(super) sample: Sample,
    pub(super) field: CovarianceSolver,
}
