//! Networks on burn's devices, and systems that the paper compares itself with.

use lsdc_core::Completer;
use lsdc_eval::evaluation::Candidate;
use lsdc_eval::predict::SystemKind;
use lsdc_files::error::{Error, Result};
use lsdc_paper::systems::Predictor;
use lsdc_train::device::{Device, device};
use std::path::{Path, PathBuf};

/// Opens weights on the CPU or a device of burn, both by name.
pub(super) fn open_completer(weights: Option<&Path>, name: &str) -> Result<Completer> {
    lsdc_train::predict::open_completer(weights, &device(name)?)
}

/// Opens the weights of a system that `--method` names.
pub(in crate::cli) fn open_system(
    kind: SystemKind,
    weights: Option<&Path>,
    device_name: &str,
) -> Result<Predictor> {
    let device = device(device_name)?;
    let name = kind.name();
    let path = weights.ok_or_else(|| {
        Error::config(format!(
            "method `{name}` needs weights of its own, which do not come with the program"
        ))
        .hint(format!(
            "train them (`lsdc train --method {name}`), then give --weights runs/{name}/weights.safetensors"
        ))
    })?;
    let predictor = Predictor::open(path, &device)?;
    if predictor.kind() == kind {
        return Ok(predictor);
    }
    let found = predictor.kind().name();
    Err(Error::config(format!(
        "`{}` holds weights of {found}, not of {name}",
        path.display()
    ))
    .hint(format!("give --method {found}")))
}

/// Opens the systems of `--system`, named by their method unless otherwise.
pub(in crate::cli) fn systems(
    files: &[(Option<String>, PathBuf)],
    device: &Device,
) -> Result<Vec<(String, Predictor)>> {
    let opened = files.iter().map(|(name, path)| {
        let predictor = Predictor::open(path, device)?;
        let own = || predictor.kind().name().to_owned();
        Ok((name.clone().unwrap_or_else(own), predictor))
    });
    opened.collect()
}

/// Opens the systems of `--system` as candidates of an evaluation.
pub(in crate::cli) fn system_candidates(
    files: &[(Option<String>, PathBuf)],
    device_name: &str,
) -> Result<Vec<(String, Candidate)>> {
    // burn opens a GPU for systems alone.
    if files.is_empty() && cfg!(feature = "gpu") && device_name.starts_with("wgpu") {
        return Ok(Vec::new());
    }
    let opened = systems(files, &device(device_name)?)?.into_iter();
    let candidates = opened.map(|(name, predictor)| (name, predictor.candidate(None)));
    Ok(candidates.collect())
}
