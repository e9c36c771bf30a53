//! Weights by name, and the pretrained encoders that some of them need.
//!
//! The weights of the program are built into this library ([`embedded`]). Encoders trained and published by others are read
//! from their published files, identified by their values, and stored in the user's data folder ([`Store`]), where
//! [`encoder_of`] finds them.
//!
//! ```
//! # fn main() -> lsdc_files::error::Result<()> {
//! # #[cfg(feature = "weights")] {
//! let weights = lsdc_weights::named("small").expect("built in").read()?;
//! let mut builder = lsdc_core::Completer::builder(&weights);
//! if let Some(encoder) = lsdc_weights::encoder_of(&weights.network)? {
//!     builder = builder.encoder(encoder);
//! }
//! let completer = builder.build()?;
//! # }
//! # Ok(())
//! # }
//! ```

mod by_name;
#[cfg(feature = "download")]
mod download;
mod embedded;
mod golden;
pub mod history;
mod installed;
mod known;
mod names;
#[cfg(feature = "gpu")]
mod on_gpu;
#[cfg(feature = "onnx")]
mod onnx;
mod pickle;
pub mod provenance;
mod pytorch;
mod store;
mod stored;
pub mod training_sets;
mod write;

pub use by_name::{
    SYSTEM_NOTE, embedded_with, is_system, names_no_network, open_completer, open_weights,
    weights_fit, weights_hash, weights_name,
};
#[cfg(feature = "download")]
pub use download::{DownloadEvent, DownloadLimits, get};
pub use embedded::{Embedded, embedded, named};
pub use golden::golden;
pub use installed::{
    InstalledDepthAnything, ResizeLayer, completer, depth_anything, encoder_of, guided_by_head,
    head_hash, installed, installed_head,
};
pub use known::{ANYTHING, KNOWN, KnownEncoder, KnownHead, identity, recognise};
pub use lsdc_files::error;
#[cfg(feature = "gpu")]
pub use on_gpu::gpu_network;
#[cfg(feature = "onnx")]
pub use onnx::{OPSET, to_onnx};
pub use store::{FOLDER, Installation, Store, how_to_install};
pub use write::{Precision, stored_bytes, to_bytes};

/// Note of a weights file with its training settings.
pub const TRAINING_NOTE: &str = "training";

/// Note of a weights file with its scores on held-out frames, at 500 points.
pub const SCORES_NOTE: &str = "held_out";

use error::{Error, Result};
use lsdc_core::weights::Tensor;
use safetensors::SafeTensors;
use safetensors::tensor::Dtype;
use std::collections::BTreeMap;
use std::path::Path;
use stored::FloatType;

/// Size limit of a file with an encoder.
const MAX_BYTES: u64 = 1 << 31;

/// Reads the tensors of an encoder under `DINOv2`'s names, from a `PyTorch` file (`.pth`, `.pt`) or a safetensors file with
/// the names of `DINOv2`, Depth Anything or Hugging Face's transformers. Other tensors in the file, such as a depth head,
/// are left out.
///
/// # Errors
/// The file cannot be read, is damaged, or contains no encoder.
pub fn read_encoder(path: &Path) -> Result<BTreeMap<String, Tensor>> {
    names::dinov2(path, read_tensors(path)?)
}

/// Reads all floating-point tensors of a `PyTorch` file (`.pth`, `.pt`) or a safetensors file, under their names in the
/// file.
///
/// # Errors
/// The file cannot be read or is damaged.
pub fn read_tensors(path: &Path) -> Result<BTreeMap<String, Tensor>> {
    let bytes = read_bounded(path)?;
    if bytes.starts_with(b"PK") {
        pytorch::read(path, &bytes)
    } else {
        from_safetensors(path, &bytes)
    }
}

/// Returns the bytes of a file that may contain an encoder.
fn read_bounded(path: &Path) -> Result<Vec<u8>> {
    let size = std::fs::metadata(path)
        .map_err(|e| Error::read(path, e))?
        .len();
    if size > MAX_BYTES {
        let what = format!("{size} bytes are too many for an encoder");
        return Err(Error::format(path, what));
    }
    std::fs::read(path).map_err(|e| Error::read(path, e))
}

fn from_safetensors(path: &Path, bytes: &[u8]) -> Result<BTreeMap<String, Tensor>> {
    let file = SafeTensors::deserialize(bytes).map_err(|e| {
        Error::format(path, "is neither a PyTorch nor a safetensors file")
            .because(e)
            .hint("PyTorch files before version 1.6 must be saved again")
    })?;
    let mut all = BTreeMap::new();
    for (name, view) in file.tensors() {
        let kind = match view.dtype() {
            Dtype::F32 => FloatType::F32,
            Dtype::F16 => FloatType::F16,
            Dtype::BF16 => FloatType::Bf16,
            // Batch counters and the like.
            _ => continue,
        };
        let tensor = Tensor::new(view.shape().to_vec(), kind.values(view.data()));
        let tensor = tensor.ok_or_else(|| Error::format(path, format!("`{name}` is damaged")))?;
        all.insert(name, tensor);
    }
    Ok(all)
}

#[cfg(test)]
mod hostile;
#[cfg(test)]
mod tests;
