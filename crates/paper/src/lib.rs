//! The experiments of "Depth-Independent Depth Completion via Least Square Estimation" (Fang et al.), and the systems compared
//! in the paper.
//!
//! [`systems`] are sparse-to-dense, spatial propagation and learned steering kernels, trained with the runs of `lsdc-train`;
//! [`experiment`] evaluates them and our method with `lsdc-eval`, and writes tables and figures.
//!
//! ```
//! use lsdc_paper::experiment::Experiment;
//! assert!(Experiment::ALL.len() > 5);
//! ```

pub mod experiment;
pub mod systems;
