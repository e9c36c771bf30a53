//! Differentiable operations on tensors of any backend: burn extensions on top of the kernels and fits
//! that completion uses too.

pub mod conv;
pub mod conv_norm;
#[cfg(feature = "wgpu")]
mod gpu;
pub mod interpolate;
mod joint;
mod lstsq;
pub mod norm;
pub mod propagate;
mod reweighted;

pub use joint::{JointBackend, JointFit, Problems, joint};
pub use lstsq::{Factored, LstsqBackend, lstsq};
pub use reweighted::{Reweighting, RobustGradient, reweighted};
