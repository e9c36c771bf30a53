//! The network on burn's tensors, trainable on every device: from images to basis functions and affinities. It reads no files
//! or datasets, and no sparse depths. Its sizes are defined in `lsdc_core::network`, which prepares it for the CPU.

mod affinities;
mod affinity_net;
mod backbone;
mod bases;
mod basis_net;
mod cost;
mod decoder;
mod encoding;
mod extractor;
mod grid;
pub mod layers;
mod on_device;
pub mod parameters;
mod pooling;
#[cfg(test)]
mod prepared_tests;
#[cfg(test)]
mod random_encoder;
#[cfg(test)]
mod tests;
mod vision;
pub mod weights;

pub(crate) use bases::every;
pub use bases::{Bases, BasisHead, HiddenBases};
pub use basis_net::{BasisNet, InitNetwork};
pub use encoding::encode;
pub use extractor::{Extractor, ExtractorOutput};
pub use on_device::{AnyEncoder, OnDevice, encoded_tensor};
pub use parameters::parameter_count;
#[cfg(test)]
pub(crate) use random_encoder::random_encoder;
pub use vision::VisionTransformer;
pub(crate) use weights::fill_part;
pub use weights::{load, transfer, weights_of};
