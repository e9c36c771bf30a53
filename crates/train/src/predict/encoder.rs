//! The pretrained encoder of a network.

use crate::model::{AnyEncoder, VisionTransformer};
use burn::tensor::Device;
use lsdc_core::network::{EncoderConfig, NetworkConfig};
use lsdc_files::error::Result;
use lsdc_weights::{encoder_of, installed};
use std::sync::Arc;

/// Opens the encoder like [`encoder_of`], for a network that is run on a device.
///
/// # Errors
/// The errors of [`encoder_of`].
pub(super) fn encoder_on(network: &NetworkConfig, device: &Device) -> Result<Option<AnyEncoder>> {
    if network.extractor.encoder == 0 || *device == Device::flex() {
        return Ok(encoder_of(network)?.map(AnyEncoder::Prepared));
    }
    let transformer = VisionTransformer::new(EncoderConfig::small(), &installed()?, device)?;
    Ok(Some(AnyEncoder::OnDevice(Arc::new(transformer))))
}
