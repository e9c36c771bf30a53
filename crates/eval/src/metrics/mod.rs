//! Errors of a dense depth map against the truth, and their averages. No tensors.

mod certainty;
mod edge;
mod paired;
mod profile;
mod ranges;
mod scores;
mod tally;

pub use certainty::{Certainty, Foretold, LEVELS, SLICES, Slice};
pub use paired::Difference;
pub use profile::{Axis, Bin, Profile};
pub use ranges::{Count, Ranges, STARTS, total};
pub use scores::{Metric, Rules, Scores};
pub use tally::{Tally, deviation};
