//! Frames to samples (plain arrays) to batches (tensors).

mod augment;
mod batch;
mod loader;
mod patches;
mod pattern;
mod protocol;
mod resize;

pub use augment::AugmentConfig;
pub use batch::{Batch, image_tensor, image_values};
pub use loader::{Loader, Sampler, SamplerConfig};
pub use patches::{Sample, SupervisionConfig};
pub use pattern::Pattern;
pub use protocol::{Interpolation, Protocol, Size};
pub use resize::{resize_depth_bilinear, resize_depth_nearest, resize_rgb};
