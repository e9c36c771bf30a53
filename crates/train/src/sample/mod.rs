//! Frames to samples (plain arrays) to batches (tensors).

mod augment;
mod batch;
mod encoding;
mod flaws;
mod halves;
mod loader;
mod order;
mod patches;

pub use augment::AugmentConfig;
pub use batch::{Batch, image_tensor, image_values};
pub use encoding::{Encoding, Said};
pub use flaws::Flaw;
pub use halves::Halves;
pub use loader::{Loader, Sampler, SamplerConfig};
pub use order::Order;
pub use patches::{Sample, SupervisionConfig};
