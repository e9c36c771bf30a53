//! The completer of `lsdc-core` on any device.

mod encoder;

use encoder::encoder_on;

use crate::device::Device;
use crate::model::{OnDevice, load};
use lsdc_core::network::NormKind;
use lsdc_core::{Completer, Weights};
use lsdc_files::error::Result;
use lsdc_weights::{names_no_network, open_weights, weights_fit};
use std::path::Path;
use std::sync::Arc;

/// Opens weights, from a file or built in, on a device; `none` means no network.
///
/// # Errors
/// A file cannot be read or is not a weights file.
pub fn open_completer(weights: Option<&Path>, device: &Device) -> Result<Completer> {
    if names_no_network(weights) {
        return Ok(Completer::without_network(weights_fit(weights)?)?);
    }
    completer(&open_weights(weights)?, device)
}

/// Opens weights with the fit that they were trained for: prepared for the CPU or a GPU if possible, otherwise on burn's
/// tensors.
///
/// # Errors
/// Weights do not match their network, or a GPU cannot be opened.
pub fn completer(weights: &Weights, device: &Device) -> Result<Completer> {
    let network = &weights.network;
    let prepared = network.norm == NormKind::Batch && !network.hidden.is_empty();
    if *device == Device::flex() && prepared {
        return lsdc_weights::completer(weights);
    }
    #[cfg(feature = "wgpu")]
    if lsdc_gpu::supports(network)
        && let Some(gpu) = crate::device::gpu(device)?
    {
        let network = if network.extractor.encoder > 0 {
            let encoder = lsdc_gpu::Pretrained {
                config: lsdc_core::network::EncoderConfig::small(),
                encoder: &lsdc_weights::installed()?,
                head: None,
            };
            lsdc_gpu::GpuNetwork::with_encoder(weights, &encoder, &gpu)?
        } else {
            lsdc_gpu::GpuNetwork::new(weights, &gpu)?
        };
        let builder = Completer::builder(weights).network(Arc::new(network));
        return Ok(builder.build()?);
    }
    plain_completer(weights, device)
}

/// Opens weights with the network on burn's tensors: the plain reference of the prepared one.
///
/// # Errors
/// Weights do not match their network.
pub fn plain_completer(weights: &Weights, device: &Device) -> Result<Completer> {
    let encoder = encoder_on(&weights.network, device)?;
    let network = OnDevice::new(load(weights, device)?, encoder, device);
    Ok(Completer::builder(weights)
        .network(Arc::new(network))
        .build()?)
}
