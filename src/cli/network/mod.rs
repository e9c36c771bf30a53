//! Opens what `--weights`, `--device`, `--method` and `--system` name, as far as the build has it.

#[cfg(not(feature = "train"))]
mod prepared;
#[cfg(feature = "train")]
mod trainable;

#[cfg(not(feature = "train"))]
pub(super) use prepared::{needs_training, open_completer, open_system, system_candidates};
#[cfg(feature = "train")]
pub(super) use trainable::{open_completer, open_system, system_candidates, systems};
