//! Encoders that others trained and published, from the files that people have of them.

mod names;
mod pickle;
mod pytorch;
mod stored;

use crate::error::{Error, Result};
use half::f16;
use lsdc_core::weights::Tensor;
use lsdc_rng::hash;
use safetensors::SafeTensors;
use safetensors::tensor::Dtype;
use std::collections::BTreeMap;
use std::path::Path;
use stored::Kind;

/// An encoder that is known.
#[derive(Clone, Copy, Debug)]
pub struct Known {
    /// What it is.
    pub name: &'static str,
    /// The licence of its weights.
    pub licence: &'static str,
    /// [`identity`] of its tensors.
    pub identity: u64,
}

/// All of them.
pub const KNOWN: [Known; 1] = [Known {
    name: "Depth Anything V2 Small (ViT-S/14)",
    licence: "Apache-2.0",
    identity: 0x15e3_74e0_afa1_3f76,
}];

/// Larger files are no encoder of this kind.
const MOST_BYTES: u64 = 1 << 31;

/// Reads the tensors of an encoder by `DINOv2`'s names, from a `PyTorch` file (`.pth`, `.pt`) or a safetensors file,
/// with the names of `DINOv2`, Depth Anything or Hugging Face's transformers. Whatever else is in the file, such as a
/// depth head, is left out.
///
/// # Errors
/// A file that cannot be read, is damaged, or holds no encoder.
pub fn read_encoder(path: &Path) -> Result<BTreeMap<String, Tensor>> {
    let size = std::fs::metadata(path)
        .map_err(|e| Error::read(path, e))?
        .len();
    if size > MOST_BYTES {
        return Err(Error::format(
            path,
            format!("{size} bytes are too many for an encoder"),
        ));
    }
    let bytes = std::fs::read(path).map_err(|e| Error::read(path, e))?;
    let all = if bytes.starts_with(b"PK") {
        pytorch::read(path, &bytes)?
    } else {
        from_safetensors(path, &bytes)?
    };
    names::dinov2(path, all)
}

/// The encoder that the user has added.
///
/// # Errors
/// None has been added.
pub fn installed() -> Result<BTreeMap<String, Tensor>> {
    let path = std::env::var_os("LSDC_ENCODER").unwrap_or_default();
    read_encoder(Path::new(&path))
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
            Dtype::F32 => Kind::F32,
            Dtype::F16 => Kind::F16,
            Dtype::BF16 => Kind::Bf16,
            // Counters of batches and the like.
            _ => continue,
        };
        let tensor = Tensor::new(view.shape().to_vec(), kind.values(view.data()));
        let tensor = tensor.ok_or_else(|| Error::format(path, format!("`{name}` is damaged")))?;
        all.insert(name, tensor);
    }
    Ok(all)
}

/// A number that depends on the names, shapes and values of tensors, rounded to half precision: the same for every
/// container and precision of a network.
pub fn identity(tensors: &BTreeMap<String, Tensor>) -> u64 {
    let mut parts: Vec<Vec<u8>> = Vec::new();
    for (name, tensor) in tensors {
        let shape: Vec<String> = tensor.shape().iter().map(usize::to_string).collect();
        parts.push(format!("{name} {}", shape.join("x")).into_bytes());
        let values = tensor.values().iter();
        parts.push(
            values
                .flat_map(|&v| f16::from_f32(v).to_le_bytes())
                .collect(),
        );
    }
    let parts: Vec<&[u8]> = parts.iter().map(Vec::as_slice).collect();
    hash(&parts)
}

/// Which of the known encoders these tensors are.
///
/// # Errors
/// None of them; the message says what was expected.
pub fn known(path: &Path, tensors: &BTreeMap<String, Tensor>) -> Result<&'static Known> {
    let found = identity(tensors);
    KNOWN
        .iter()
        .find(|known| known.identity == found)
        .ok_or_else(|| {
            let names: Vec<&str> = KNOWN.iter().map(|known| known.name).collect();
            Error::format(
                path,
                format!("holds an encoder of other values ({found:016x}) than any that is known"),
            )
            .hint(format!(
                "known are: {}. The file may be damaged, or of another network",
                names.join(", ")
            ))
        })
}

#[cfg(test)]
mod tests;
