//! Depth completion by least squares: an RGB image and a few sparse depths in, dense depth out.

mod observations;

pub use observations::{Observation, Observations};
