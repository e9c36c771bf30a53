//! The pretrained encoder below a network.

use crate::model::{AnyEncoder, VisionTransformer};
use burn::tensor::Device;
use lsdc_core::network::{EncoderConfig, NetworkConfig};
use lsdc_files::error::Result;
use lsdc_weights::{encoder_of, installed};
use std::sync::Arc;

/// [`encoder_of`] where the network is computed on a device.
///
/// # Errors
/// As [`encoder_of`].
pub(super) fn encoder_on(network: &NetworkConfig, device: &Device) -> Result<Option<AnyEncoder>> {
    if network.extractor.encoder == 0 || *device == Device::flex() {
        return Ok(encoder_of(network)?.map(AnyEncoder::Prepared));
    }
    let transformer = VisionTransformer::new(EncoderConfig::small(), &installed()?, device)?;
    Ok(Some(AnyEncoder::OnDevice(Arc::new(transformer))))
}
