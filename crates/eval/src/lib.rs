//! Evaluation of depth completion: datasets, protocols, metrics, the comparison of methods, and reports.
//!
//! Data flows one way: [`data`] reads frames, [`sampling`] prepares them and draws sparse points, [`predict`] completes
//! them, [`metrics`] and [`evaluation`] measure the results, [`report`] writes them.
//!
//! ```
//! # fn main() -> lsdc_files::error::Result<()> {
//! use lsdc_eval::data::{Dataset as _, Rooms, RoomsConfig, Split};
//! use lsdc_eval::metrics::{Metric, Rules, Scores};
//! use lsdc_eval::predict::{Classic, complete_classic};
//! use lsdc_eval::sampling::Pattern;
//! let frame = Rooms::new(Split::Val, &RoomsConfig::default())?.load(0)?;
//! let sparse = Pattern::Exactly(500).draw(&frame, 0)?;
//! let depth = complete_classic(Classic::Linear, &frame.rgb, &sparse)?;
//! let scores = Scores::of(&depth, &frame.depth, &Rules::default())?;
//! assert!(scores[Metric::Rmse] < 1.0);
//! # Ok(())
//! # }
//! ```
//!
//! Weights come from `lsdc-weights`, files from `lsdc-files`; `lsdc-train` trains on the same datasets.

pub mod data;
pub mod evaluation;
pub mod fit_settings;
pub mod metrics;
pub mod predict;
pub mod report;
pub mod sampling;

/// Returns the indices within `reach` of `at` that are below `length`.
fn window(at: usize, reach: usize, length: usize) -> std::ops::Range<usize> {
    at.saturating_sub(reach)..at.saturating_add(reach + 1).min(length)
}
