//! CPU kernels of lsdc for inference and training, on every instruction set.
//!
//! All functions are safe: they check the lengths of their arguments, and kernels are private. Every sum has a fixed order, so
//! results are bitwise equal for any number of threads. They differ in rounding between instruction sets.
//!
//! ```
//! use lsdc_kernels::{attention::gelu, simd::Level};
//! let mut values = [-3.0, 0.0, 3.0];
//! gelu(Level::here(), &mut values);
//! assert!(values[0].abs() < 0.01 && values[1] == 0.0 && (values[2] - 3.0).abs() < 0.01);
//! ```
//!
//! `lsdc-core` runs the network and the fit on them; `lsdc-train` uses their gradients.

#![allow(unsafe_code)]

pub mod attention;
pub mod cholesky;
pub mod clock;
pub mod conv;
pub mod gather;
pub mod norm;
pub mod propagate;
pub mod schedule;
pub mod simd;

/// Checks that `values` are rows of this many channels.
fn check_rows(values: &[f32], channels: usize) {
    assert!(
        values.is_empty() || (channels > 0 && values.len().is_multiple_of(channels)),
        "{} values are not rows of {channels} channels",
        values.len()
    );
}
