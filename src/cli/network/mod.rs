//! Opens what `--weights`, `--device`, `--method`, `--system`, `--guide` and `--quality` name, as far as the build has it.

#[cfg(feature = "gpu")]
mod gpu;
mod guide;
#[cfg(not(feature = "train"))]
mod prepared;
mod quality;
#[cfg(feature = "train")]
mod trainable;

use lsdc_core::Completer;
use lsdc_files::error::Result;
use std::path::Path;

#[cfg(not(feature = "train"))]
use prepared::open_completer as open_on_cpu_or_burn;
#[cfg(feature = "train")]
use trainable::open_completer as open_on_cpu_or_burn;

pub(super) use guide::{named as name_of_own_guide, open_guide, open_guided_completer, own_guide};
#[cfg(not(feature = "train"))]
pub(super) use prepared::{needs_training, open_system, system_candidates};
pub(super) use quality::at_quality;
#[cfg(any(feature = "serve", feature = "node"))]
pub(super) use quality::with_encoder_side;
#[cfg(feature = "train")]
pub(super) use trainable::{open_system, system_candidates, systems};

/// Opens weights on a device, both by name: with the kernels of `lsdc-gpu` if they have this network. With `guided`, they can
/// predict the guide of its scenes.
#[cfg_attr(not(feature = "gpu"), expect(unused_variables))]
pub(super) fn open_completer(
    weights: Option<&Path>,
    device: &str,
    guided: bool,
) -> Result<Completer> {
    #[cfg(feature = "gpu")]
    if let Some(completer) = gpu::open_completer(weights, device, guided)? {
        return Ok(completer);
    }
    open_on_cpu_or_burn(weights, device)
}
