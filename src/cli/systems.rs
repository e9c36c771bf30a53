//! Weights of the systems that the paper compares itself with.

use crate::error::{Error, Result};
use crate::systems::{Predictor, SystemKind};
use burn::tensor::Device;
use std::path::{Path, PathBuf};

/// Opens the weights of a system that `--method` names.
pub(super) fn open_system(
    kind: SystemKind,
    weights: Option<&Path>,
    device: &Device,
) -> Result<Predictor> {
    let name = kind.name();
    let path = weights.ok_or_else(|| {
        Error::config(format!(
            "method `{name}` needs weights of its own, which do not come with the program"
        ))
        .hint(format!(
            "train them (`lsdc train --method {name}`), then give --weights runs/{name}/weights.safetensors"
        ))
    })?;
    let predictor = Predictor::open(path, device)?;
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
pub(super) fn systems(
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
