//! Networks prepared for a GPU.

use crate::cli::{install, ui};
use lsdc_core::Completer;
use lsdc_core::network::EncoderConfig;
use lsdc_files::error::{Error, Result};
use lsdc_gpu::{Adapter, Gpu, GpuNetwork, Pretrained, supports};
use lsdc_weights::{installed, installed_head, names_no_network, open_weights};
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
    if !supports(&weights.network) {
        return Ok(None);
    }
    let gpu = name.parse::<Adapter>().and_then(Gpu::shared);
    let gpu = gpu.map_err(|error| {
        let hint = error.hint();
        Error::device(error.to_string()).hint(hint)
    })?;
    let network = if weights.network.extractor.encoder > 0 {
        let head = if guided { installed_head()? } else { None };
        if guided && head.is_none() {
            ui::say(install::UNGUIDED);
        }
        let encoder = Pretrained {
            config: EncoderConfig::small(),
            encoder: &installed()?,
            head: head.as_ref(),
        };
        GpuNetwork::with_encoder(&weights, &encoder, &gpu)?
    } else {
        GpuNetwork::new(&weights, &gpu)?
    };
    let builder = Completer::builder(&weights).network(Arc::new(network));
    Ok(Some(builder.build()?))
}
