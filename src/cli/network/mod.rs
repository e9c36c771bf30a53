//! Opens what `--weights`, `--device`, `--method`, `--system`, `--guide` and `--quality` name, as far as the build has it.

#[cfg(feature = "gpu")]
mod gpu;
mod guide;
#[cfg(not(feature = "train"))]
mod prepared;
mod quality;
#[cfg(feature = "train")]
mod trainable;

pub(super) use guide::{named as name_of_own_guide, open_guide, open_guided_completer, own_guide};
#[cfg(not(feature = "train"))]
pub(super) use prepared::{needs_training, open_completer, open_system, system_candidates};
pub(super) use quality::at_quality;
#[cfg(feature = "train")]
pub(super) use trainable::{open_completer, open_system, system_candidates, systems};
