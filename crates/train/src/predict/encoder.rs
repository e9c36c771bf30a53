//! The pretrained encoder below a network.

use crate::model::{AnyEncoder, LastBlocks, VisionTransformer};
use burn::tensor::Device;
use lsdc_core::network::{AdapterConfig, EncoderConfig, NetworkConfig};
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

/// The first block of the encoder that adapters of a network change.
pub fn first_adapted(network: &NetworkConfig) -> Option<usize> {
    let adapters = network.adapters?;
    EncoderConfig::small().blocks.checked_sub(adapters.blocks)
}

/// The blocks of the encoder that adapters of a network change, on a device; nothing if it has none.
///
/// # Errors
/// An encoder that has not been added, or is damaged.
pub fn adapted_blocks(network: &NetworkConfig, device: &Device) -> Result<Option<LastBlocks>> {
    let blocks = |adapters: AdapterConfig| -> Result<LastBlocks> {
        let (config, tensors) = (EncoderConfig::small(), installed()?);
        Ok(LastBlocks::new(&config, adapters.blocks, &tensors, device)?)
    };
    network.adapters.map(blocks).transpose()
}
