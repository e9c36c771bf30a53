//! Depth completion by least squares.

pub mod classic;
#[allow(unsafe_code)]
pub mod conv;
pub mod data;
pub mod error;
pub mod fit;
pub mod metrics;
pub mod model;
pub mod norm;
pub mod predict;
pub mod rng;
pub mod sample;
pub mod train;
