//! Networks on GPUs, with the encoder and the depth head from the user's data folder.

use crate::{installed, installed_head};
use lsdc_core::Weights;
use lsdc_core::network::EncoderConfig;
use lsdc_files::error::{Error, Result};
use lsdc_gpu::{Adapter, Gpu, GpuNetwork, Pretrained, supports};

/// Prepares the network of weights for a GPU by name (`wgpu`, `wgpu:N`, `wgpu:integrated`, `wgpu:software`), with the encoder that
/// it needs. With `guided`, the depth head of the encoder is on the GPU, too, if it is installed. `None` for networks that this
/// kind of device does not run.
///
/// # Errors
/// The GPU cannot be opened, the weights do not match their network, or the encoder is not installed.
pub fn gpu_network(weights: &Weights, name: &str, guided: bool) -> Result<Option<GpuNetwork>> {
    if !supports(&weights.network) {
        return Ok(None);
    }
    let gpu = name.parse::<Adapter>().and_then(Gpu::shared);
    let gpu = gpu.map_err(|error| Error::device(error.to_string()).hint(error.hint()))?;
    let network = if weights.network.extractor.encoder == 0 {
        GpuNetwork::new(weights, &gpu)
    } else {
        let head = if guided { installed_head()? } else { None };
        let encoder = Pretrained {
            config: EncoderConfig::small(),
            encoder: &installed()?,
            head: head.as_ref(),
        };
        GpuNetwork::with_encoder(weights, &encoder, &gpu)
    };
    Ok(Some(network?))
}
