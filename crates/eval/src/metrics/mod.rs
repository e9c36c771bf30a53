//! Errors of a dense depth map against the truth, and their averages, without tensors.

mod accumulator;
mod disagreement;
mod edge;
mod paired;
mod profile;
mod ranges;
mod rules;
mod scores;
mod uncertainty;

pub use accumulator::{ScoreAccumulator, mean_and_deviation};
pub use disagreement::{Disagreement, ViewDepths};
pub use paired::PairedDifference;
pub use profile::{Axis, Bin, ErrorProfile};
pub use ranges::{DepthRangeErrors, ErrorCount, RANGE_STARTS, total};
pub use rules::Rules;
pub use scores::{Metric, Scores};
pub use uncertainty::{LEVELS, PredictedErrors, SLICES, Slice, UncertaintyScores};
