//! Frames to samples (plain arrays) to batches (tensors).

mod augment;
mod batch;
mod corners;
mod encoding;
mod flaws;
mod halves;
mod hold_out;
mod loader;
mod noise;
mod occlusion;
mod order;
mod patches;
mod pattern;
mod preset;
mod protocol;
mod resize;
mod task;

pub use augment::AugmentConfig;
pub use batch::{Batch, image_tensor, image_values};
pub use encoding::{Encoding, Said};
pub use flaws::Flaw;
pub use halves::Halves;
pub use hold_out::HoldOut;
pub use loader::{Loader, Sampler, SamplerConfig};
pub use noise::Noise;
pub use occlusion::Occlusion;
pub use order::Order;
pub use patches::{Sample, SupervisionConfig};
pub use pattern::Pattern;
pub use preset::Preset;
pub use protocol::{Anchor, Jumps, Protocol, Size};
pub use resize::{Interpolation, move_points, resize_depth, resize_rgb};
pub use task::Task;
