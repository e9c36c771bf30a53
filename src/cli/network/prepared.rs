//! Networks prepared for the CPU or a GPU: all that a build without burn has.

use image::RgbImage;
use lsdc_core::Completer;
use lsdc_eval::data::DepthMap;
use lsdc_eval::evaluation::Candidate;
use lsdc_eval::predict::{DepthCompleter, SystemKind};
use lsdc_eval::sampling::Size;
use lsdc_files::error::{Error, Result};
use std::path::{Path, PathBuf};

/// Opens weights on the CPU, the only device of this build beside a GPU.
pub(super) fn open_completer(weights: Option<&Path>, name: &str) -> Result<Completer> {
    check_device(name)?;
    lsdc_weights::open_completer(weights)
}

fn check_device(name: &str) -> Result<()> {
    let (kind, _) = name.split_once(':').unwrap_or((name, ""));
    match (name, kind) {
        ("cpu", _) => Ok(()),
        (_, "wgpu" | "ndarray") => Err(Error::device(format!("this build has no device `{name}`"))
            .hint(format!(
                "`cargo install --path . --features {kind}` installs one that has"
            ))),
        _ => Err(Error::device(format!("unknown device `{name}`")).hint("this build has `cpu`")),
    }
}

/// No system: there is none in this build.
#[derive(Clone, Debug)]
pub(in crate::cli) enum NoSystem {}

impl NoSystem {
    pub(in crate::cli) fn candidate(self, _: Option<Size>) -> Candidate {
        match self {}
    }
}

impl DepthCompleter for NoSystem {
    fn depth(&self, _: &RgbImage, _: &DepthMap) -> Result<DepthMap> {
        match *self {}
    }
}

/// Says that a system needs another build.
pub(in crate::cli) fn open_system(kind: SystemKind, _: Option<&Path>, _: &str) -> Result<NoSystem> {
    Err(missing(kind.name()))
}

/// Fails if there are systems of `--system`, which need another build.
pub(in crate::cli) fn system_candidates(
    files: &[(Option<String>, PathBuf)],
    device: &str,
) -> Result<Vec<(String, Candidate)>> {
    check_device(device)?;
    match files {
        [] => Ok(Vec::new()),
        [(_, path), ..] => Err(missing(&path.display().to_string())),
    }
}

fn missing(what: &str) -> Error {
    needs_training(Error::config(format!(
        "this build cannot use the system `{what}`"
    )))
}

/// Adds how to get a build with training and systems.
pub(in crate::cli) fn needs_training(error: Error) -> Error {
    error.hint(
        "it was built without the feature `train`; `cargo install --path .` installs one with it",
    )
}
