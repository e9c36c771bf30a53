//! Opens what `--weights`, `--device`, `--method`, `--system` and `--guide` name, as far as the build has it.

mod guide;
#[cfg(not(feature = "train"))]
mod prepared;
#[cfg(feature = "train")]
mod trainable;

pub(super) use guide::open_guide;
#[cfg(not(feature = "train"))]
pub(super) use prepared::{needs_training, open_completer, open_system, system_candidates};
#[cfg(feature = "train")]
pub(super) use trainable::{open_completer, open_system, system_candidates, systems};
