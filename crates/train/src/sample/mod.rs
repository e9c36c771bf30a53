//! Frames to samples (plain arrays) to batches (tensors).

mod augment;
mod batch;
mod degradations;
mod encoding;
mod f16_cache;
mod images;
mod loader;
mod order;
mod patches;
mod patterns;

pub use augment::AugmentConfig;
pub use batch::Batch;
pub use degradations::Degradation;
pub use encoding::Encoding;
pub use f16_cache::F16Cache;
pub use images::{image_tensor, image_values};
pub use loader::{Loader, Sampler, SamplerConfig};
pub use order::Order;
pub use patches::{Sample, SupervisionConfig};
pub use patterns::PatternShares;
