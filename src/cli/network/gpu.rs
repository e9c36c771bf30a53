//! Networks prepared for a GPU.

use crate::cli::{install, ui};
use lsdc_core::Completer;
use lsdc_files::error::Result;
use lsdc_weights::{gpu_network, names_no_network, open_weights};
use std::path::Path;
use std::sync::Arc;

/// Opens weights on a GPU, both by name; nothing for other devices, without a network, and for networks that only run on
/// burn's tensors. With `guided`, the depth head of the encoder is there, too, if the network has one and it is installed.
///
/// # Errors
/// Weights that cannot be read, and a GPU that cannot be opened.
pub(super) fn open_completer(
    weights: Option<&Path>,
    name: &str,
    guided: bool,
) -> Result<Option<Completer>> {
    if !name.starts_with("wgpu") || names_no_network(weights) {
        return Ok(None);
    }
    let weights = open_weights(weights)?;
    let Some(network) = gpu_network(&weights, name, guided)? else {
        return Ok(None);
    };
    let builder = Completer::builder(&weights).network(Arc::new(network));
    let completer = builder.build()?;
    if guided && weights.network.extractor.encoder > 0 && !completer.has_depth_head() {
        ui::say(install::UNGUIDED);
    }
    Ok(Some(completer))
}
