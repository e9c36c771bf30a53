//! The weights of a joint fit, and the observations from which they were estimated.

use super::merged_observations::SampledObservations;
use crate::fit::lstsq::Solution;

/// The weights of basis functions and cosines.
pub(super) struct WeightEstimate {
    pub(super) solution: Solution,
    pub(super) noise: f64,
    pub(super) lambda: f64,
    /// The number of directions of the weights that the observations determine.
    pub(super) determined: f64,
    /// The observations from which the weights were estimated.
    pub(super) sample: SampledObservations,
}
