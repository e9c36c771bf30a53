//! Networks for depth completion on burn's tensors, and their training.
//!
//! [`ops`] are differentiable operations, [`model`] the network, [`sample`] turns frames into batches, [`training`] is
//! a run with all that follows it, and [`predict`] completes depth on any [`device`].
//!
//! ```
//! # fn main() -> lsdc_files::error::Result<()> {
//! use lsdc_core::network::NetworkConfig;
//! use lsdc_train::device::device;
//! use lsdc_train::model::InitNetwork as _;
//! let net = NetworkConfig::small().init(0, &device("cpu")?)?;
//! # let _ = net;
//! # Ok(())
//! # }
//! ```
//!
//! Datasets and metrics come from `lsdc-eval`, weights files from `lsdc-weights`; `lsdc-paper` trains other systems with
//! the same runs.

// burn's authors deprecate ndarray in favour of flex; it stays available on request.
#![cfg_attr(feature = "ndarray", allow(deprecated))]

pub mod device;
pub mod model;
pub mod ops;
pub mod predict;
pub mod sample;
pub mod training;
