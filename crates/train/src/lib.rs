//! Networks for depth completion on burn's tensors, and their training.
//!
//! [`ops`] are differentiable operations, [`model`] is the network, [`sample`] turns frames into batches, [`training`] runs
//! training, calibration and publishing, and [`predict`] completes depth on any [`device`].
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
//! Datasets and metrics come from `lsdc-eval`, weights files from `lsdc-weights`; `lsdc-paper` trains other systems with the
//! same training runs.

// burn deprecates ndarray in favour of flex; it remains available on request.
#![cfg_attr(feature = "ndarray", allow(deprecated))]

pub mod device;
pub mod model;
pub mod ops;
pub mod predict;
pub mod sample;
pub mod traffic;
pub mod training;
