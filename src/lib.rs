//! Depth completion by least squares: an RGB image and a few sparse depths in, dense depth out.
//!
//! A network turns the image alone into basis functions; a least-squares fit finds the weights that
//! match the sparse depths; dense depth = bases x weights (Fang et al., "Depth-Independent Depth
//! Completion via Least Square Estimation"). Depths are metres along the optical axis.
//!
//! ```no_run
//! # fn main() -> lsdc::error::Result<()> {
//! use lsdc::{data, predict};
//! use lsdc_core::{Completer, Weights};
//! let image = data::read_rgb("rgb.png".as_ref())?;
//! let points = data::read_npy("sparse.npy".as_ref(), 1.0)?;
//! let completer = Completer::new(&Weights::builtin())?;
//! let depth = predict::complete(&completer, &image, &points)?.depth()?;
//! # Ok(())
//! # }
//! ```

// burn's authors deprecate ndarray in favour of flex; it stays available on request.
#![cfg_attr(feature = "ndarray", allow(deprecated))]

pub mod cli;
pub mod config;
pub mod data;
pub mod device;
pub mod eval;
pub mod experiment;
pub mod fit_settings;
pub mod history;
pub mod metrics;
pub mod model;
pub mod ops;
pub mod predict;
#[allow(unsafe_code)]
pub mod process;
pub mod provenance;
mod renamed;
pub mod report;
pub mod sample;
pub mod systems;
pub mod train;

pub use lsdc_files::error;
