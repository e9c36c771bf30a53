//! Writer of weights files: safetensors with metadata.

use crate::error::{Error, Result};
use crate::known::f16_bytes;
use lsdc_core::Weights;
use lsdc_core::weights::{NETWORK, NORMALISATION, TABLE, Tensor, VERSION};
use safetensors::tensor::{Dtype, TensorView};
use std::collections::{BTreeMap, HashMap};

/// Storage precision of the numbers of a network.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Precision {
    /// Two bytes each (IEEE 754 binary16), except for tensors with numbers that do not fit: variances of features are large
    /// if weights have grown.
    #[default]
    Half,
    /// Four bytes each.
    Single,
}

impl Precision {
    /// Returns the name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Half => "f16",
            Self::Single => "f32",
        }
    }
}

/// Returns the bytes of a safetensors file with the network's tensors in this precision, and f32 tables.
///
/// # Errors
/// A record cannot be written as JSON.
pub fn to_bytes(weights: &Weights, precision: Precision) -> Result<Vec<u8>> {
    let broken =
        |e: &dyn std::fmt::Display| Error::weights(format!("the weights cannot be written: {e}"));
    let mut metadata: HashMap<String, String> = weights.notes.clone().into_iter().collect();
    let network = serde_json::to_string(&weights.network).map_err(|e| broken(&e))?;
    let normalisation = serde_json::to_string(&weights.normalisation).map_err(|e| broken(&e))?;
    metadata.insert(VERSION.into(), env!("CARGO_PKG_VERSION").into());
    metadata.insert(NETWORK.into(), network);
    metadata.insert(NORMALISATION.into(), normalisation);
    let tensors = weights.tensors.iter();
    let tensors = tensors.map(|(name, tensor)| (name.clone(), tensor, precision));
    let tables = weights.tables.iter();
    let tables = tables.map(|(name, table)| (format!("{TABLE}{name}"), table, Precision::Single));
    stored_bytes(tensors.chain(tables), metadata)
}

/// Returns the bytes of a safetensors file of named tensors, each with its precision, and metadata.
///
/// # Errors
/// The file would be too large.
#[expect(clippy::implicit_hasher, reason = "the map that safetensors takes")]
pub fn stored_bytes<'a>(
    tensors: impl Iterator<Item = (String, &'a Tensor, Precision)>,
    metadata: HashMap<String, String>,
) -> Result<Vec<u8>> {
    let broken =
        |e: &dyn std::fmt::Display| Error::weights(format!("the weights cannot be written: {e}"));
    let tensors = tensors.map(|(name, tensor, precision)| (name, stored(tensor, precision)));
    let all: BTreeMap<String, (Dtype, &[usize], Vec<u8>)> = tensors.collect();
    let views = all
        .iter()
        .map(|(name, (dtype, shape, bytes))| {
            let view = TensorView::new(*dtype, shape.to_vec(), bytes);
            view.map(|view| (name, view)).map_err(|e| broken(&e))
        })
        .collect::<Result<Vec<_>>>()?;
    safetensors::serialize(views, Some(metadata)).map_err(|e| broken(&e))
}

/// Returns type, shape and bytes of a tensor in a file.
fn stored(tensor: &Tensor, precision: Precision) -> (Dtype, &[usize], Vec<u8>) {
    let mut values = tensor.values().iter();
    if precision == Precision::Half && values.all(|v| v.abs() <= half::f16::MAX.to_f32()) {
        return (Dtype::F16, tensor.shape(), f16_bytes(tensor));
    }
    let bytes = tensor.values().iter().flat_map(|v| v.to_le_bytes());
    (Dtype::F32, tensor.shape(), bytes.collect())
}
