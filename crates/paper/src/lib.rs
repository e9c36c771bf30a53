//! The experiments of "Depth-Independent Depth Completion via Least Square Estimation" (Fang et al.), and the systems
//! that it compares itself with.
//!
//! [`systems`] are sparse-to-dense, spatial propagation and learned steering kernels, trainable with the runs of
//! `lsdc-train`; [`experiment`] measures them and our method with `lsdc-eval`, and writes the tables and figures.
//!
//! ```
//! use lsdc_paper::experiment::Experiment;
//! assert!(Experiment::ALL.len() > 5);
//! ```

pub mod experiment;
pub mod systems;
