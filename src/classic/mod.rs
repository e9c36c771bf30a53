//! Completion without training.

mod linear;

pub use linear::linear;
