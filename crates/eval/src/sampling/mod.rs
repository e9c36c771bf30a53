//! Preparation of frames for an evaluation: sizes, valid depths, sparse points, noise, and held-out pixels.

mod corners;
mod hold_out;
mod noise;
mod occlusion;
mod pattern;
mod pose_error;
mod preset;
mod protocol;
mod resize;
mod scanner;
mod size;
mod task;

pub use hold_out::HoldOut;
pub use noise::Noise;
pub use occlusion::Occlusion;
pub use pattern::Pattern;
pub use pose_error::PoseError;
pub use preset::ProtocolPreset;
pub use protocol::{Anchor, Jumps, Protocol};
pub use resize::{Interpolation, move_points, resize_depth, resize_rgb};
pub use scanner::BEAMS;
pub use size::Size;
pub use task::CompletionTask;
