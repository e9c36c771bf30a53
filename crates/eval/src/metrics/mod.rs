//! Errors of a dense depth map against the truth, and their averages. No tensors.

mod certainty;
mod edge;
mod paired;
mod profile;
mod ranges;
mod rules;
mod scores;
mod tally;

pub use certainty::{Certainty, LEVELS, PredictedErrors, SLICES, Slice};
pub use paired::Difference;
pub use profile::{Axis, Bin, Profile};
pub use ranges::{Count, Ranges, STARTS, total};
pub use rules::Rules;
pub use scores::{Metric, Scores};
pub use tally::{Tally, deviation};
