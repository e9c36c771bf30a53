//! Depth completion by least squares: an RGB image and a few sparse depths in, a dense depth map out.
//!
//! A network turns the image *alone* into basis functions and affinities (how strongly neighbouring pixels
//! are tied together). A least-squares fit then finds the weights of the basis functions, together with a
//! field that is smooth except across edges, so that the result matches the sparse depths (Fang et al.,
//! "Depth-Independent Depth Completion via Least Square Estimation"). Because no network ever sees a depth,
//! scaling the depths scales the result exactly, the number and pattern of the points are arbitrary, the
//! result can be evaluated at any resolution, and its errors follow in closed form.
//!
//! How to use this crate:
//!
//! 1. get [`Weights`], which are built into the crate (feature `weights`, on by default) or read from a file;
//! 2. make a [`Completer`], which all threads can share;
//! 3. make a [`Scene`] for each [`Image`]: this runs the network, once;
//! 4. make a [`Completion`] for each set of [`Observations`]: this runs a fit, from which depth, standard
//!    deviations, residuals, leave-one-out errors and outliers are computed on request.
//!
//! ```
//! # #[cfg(feature = "weights")]
//! # fn main() -> lsdc_core::Result<()> {
//! use lsdc_core::{Channels, Completer, Image, Observations, Weights};
//!
//! # let (width, height) = (64, 48);
//! # let rgb: Vec<u8> = (0..3 * width * height).map(|i| (i / 7 % 251) as u8).collect();
//! let completer = Completer::new(&Weights::builtin_small())?;
//! let scene = completer.scene(&Image::new(width, height, Channels::Rgb, &rgb)?)?;
//!
//! let mut points = Observations::new();
//! for (u, v, metres) in [(5.0, 7.5, 2.0), (40.2, 30.0, 2.2), (60.0, 12.0, 1.8), (20.0, 40.0, 2.1)] {
//!     points.add(u, v, metres);
//! }
//! let completion = scene.complete(&points)?;
//! let depth = completion.depth()?;
//! let deviation = completion.standard_deviation()?;
//! assert_eq!(depth.values().len(), deviation.values().len());
//!
//! // Twice as far is exactly twice as far.
//! let far = points.iter().map(|p| lsdc_core::Observation { depth: 2.0 * p.depth, ..*p });
//! let twice = scene.complete(&far.collect())?.depth()?;
//! assert!((twice.at(30, 20) / depth.at(30, 20) - 2.0).abs() < 1e-5);
//! # Ok(())
//! # }
//! # #[cfg(not(feature = "weights"))]
//! # fn main() {}
//! ```
//!
//! Nothing here prints, panics on bad input, or starts threads unless asked to: work runs on the caller's
//! `rayon` pool, or on one of the completer's own. The same input gives the same bits for any number of
//! threads with one instruction set, here, in the `lsdc` program and in its packages for C and Python; different
//! instruction sets round differently.
//!
//! The modules hidden from this page are used by the `lsdc` program for training; they may change at any
//! time.

mod alignment;
#[doc(hidden)]
pub mod bilinear;
mod camera;
#[doc(hidden)]
pub mod cloud;
mod comparison;
mod completer;
mod completion;
mod depth_anything;
mod depth_guide;
mod detail;
mod ensemble;
mod error;
#[doc(hidden)]
pub mod field;
#[doc(hidden)]
pub mod fit;
mod image;
mod lazy;
mod limits;
mod map;
#[doc(hidden)]
pub mod nearest;
#[doc(hidden)]
pub mod network;
mod network_output;
mod noise_model;
mod observations;
mod resize;
mod scene;
#[doc(hidden)]
pub mod sky;
mod smoothing;
mod standard_deviation;
mod tensor;
#[doc(hidden)]
pub mod upsampling;
mod usable;
mod views;
#[doc(hidden)]
pub mod weights;

pub use alignment::{Alignment, Shift};
pub use camera::{Camera, Lens};
#[doc(inline)]
pub use cloud::Cloud;
pub use comparison::{Alternative, Comparison};
#[doc(hidden)]
pub use completer::thread_pool;
pub use completer::{Completer, CompleterBuilder};
pub use completion::{Completion, Outlier, Report};
pub use depth_anything::DepthAnything;
pub use depth_guide::{DepthGuide, GuideKind};
pub use ensemble::Quality;
pub use error::{Error, FitError, ImageError, Result, SettingsError, WeightsError};
pub use image::{Channels, Image, MAX_PIXELS};
pub use limits::RANGE;
pub use map::{DepthMap, Point};
pub use network_output::{NetworkInput, NetworkOutput};
pub use noise_model::DepthNoise;
pub use observations::{Observation, Observations};
pub use scene::Scene;
pub use views::{
    PosedView, Projection, ViewOutcome, ViewReport, ViewSettings, ViewsOutcome, ViewsReport,
    neighbours,
};
#[doc(inline)]
pub use weights::Weights;

/// Settings of the fit.
pub mod settings {
    #[doc(inline)]
    pub use crate::fit::{FitConfig, FitMethod, JointConfig, Lambda, Loss, PriorKind, Robust};
}

/// Handles can be shared between threads without a lock.
const _: () = {
    const fn shared<T: Send + Sync + Clone>() {}
    shared::<Completer>();
    shared::<Scene>();
    shared::<Completion>();
    shared::<DepthAnything>();
    shared::<NetworkOutput>();
    shared::<Weights>();
    shared::<Observations>();
};
