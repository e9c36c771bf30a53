//! The encoder that weights need, from the user's data folder.

use crate::{KNOWN, Store};
use lsdc_core::network::{Encoder, EncoderConfig, NetworkConfig};
use lsdc_core::weights::Tensor;
use lsdc_core::{Completer, Weights};
use lsdc_files::error::Result;
use lsdc_kernels::simd::Level;
use std::collections::BTreeMap;
use std::sync::{Arc, OnceLock};

/// Reads the encoder of the weights `anything` from the user's data folder.
///
/// # Errors
/// It was not added (the error says how large it is, under which licence, and the commands that install it), or its file
/// was damaged since.
pub fn installed() -> Result<BTreeMap<String, Tensor>> {
    let [anything] = &KNOWN;
    Store::open()?.load(anything)
}

/// Returns the encoder that a network was trained on, prepared for the CPU; `None` if it needs none. It is prepared once in a
/// process.
///
/// # Errors
/// As [`installed`].
pub fn encoder_of(network: &NetworkConfig) -> Result<Option<Arc<Encoder>>> {
    static PREPARED: OnceLock<Arc<Encoder>> = OnceLock::new();
    if network.extractor.encoder == 0 {
        return Ok(None);
    }
    if let Some(encoder) = PREPARED.get() {
        return Ok(Some(encoder.clone()));
    }
    // Without a lock: a thread of a pool that waits here for parts of its work could take up another call of this function.
    let encoder = Encoder::new(EncoderConfig::small(), &installed()?, Level::here())?;
    Ok(Some(PREPARED.get_or_init(|| Arc::new(encoder)).clone()))
}

/// Prepares weights with the fit that they were trained for, and the encoder that they need, for the CPU.
///
/// # Errors
/// Weights that do not belong to their network, or as [`installed`].
pub fn completer(weights: &Weights) -> Result<Completer> {
    let builder = Completer::builder(weights);
    Ok(match encoder_of(&weights.network)? {
        None => builder,
        Some(encoder) => builder.encoder(encoder),
    }
    .build()?)
}
