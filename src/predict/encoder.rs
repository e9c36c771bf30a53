//! The pretrained encoder below a network.

use crate::error::Result;
use crate::model::{AnyEncoder, NetworkConfig, VisionTransformer};
use crate::pretrained::installed;
use burn::tensor::Device;
use lsdc_core::network::{Encoder, EncoderConfig};
use lsdc_kernels::simd::Level;
use std::sync::{Arc, Mutex, PoisonError};

/// The same where the network is computed on a device.
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

/// The encoder that a network was trained on; nothing if it needs none. Prepared once.
///
/// # Errors
/// An encoder that has not been added, or is damaged.
pub fn encoder_of(network: &NetworkConfig) -> Result<Option<Arc<Encoder>>> {
    static PREPARED: Mutex<Option<Arc<Encoder>>> = Mutex::new(None);
    if network.extractor.encoder == 0 {
        return Ok(None);
    }
    let mut prepared = PREPARED.lock().unwrap_or_else(PoisonError::into_inner);
    if prepared.is_none() {
        let encoder = Encoder::new(EncoderConfig::small(), &installed()?, Level::here())?;
        *prepared = Some(Arc::new(encoder));
    }
    Ok(prepared.clone())
}
