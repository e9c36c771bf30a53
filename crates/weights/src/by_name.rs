//! Weights by name or from a file.

use crate::error::{Error, Result};
use crate::{Embedded, completer, embedded};
use lsdc_core::fit::FitConfig;
use lsdc_core::{Completer, Weights};
use lsdc_rng::hash;
use safetensors::SafeTensors;
use std::borrow::Cow;
use std::path::Path;
use std::sync::LazyLock;

/// Returns the bytes of weights and their name: those of the program (borrowed), or a file, which takes precedence.
fn read(path: Option<&Path>) -> Result<(Cow<'static, [u8]>, String)> {
    let built_in = match path {
        None => embedded().first(),
        Some(path) if path.exists() => None,
        Some(path) => path.to_str().and_then(crate::named),
    };
    if let Some(weights) = built_in {
        return Ok((weights.bytes.into(), weights.name.to_owned()));
    }
    let path = path.unwrap_or(Path::new(""));
    let bytes = std::fs::read(path).map_err(|e| {
        let names: Vec<&str> = embedded().iter().map(|w| w.name).collect();
        Error::read(path, e).hint(format!(
            "give a weights file, or one of the program's: {}",
            names.join(", ")
        ))
    })?;
    Ok((bytes.into(), path.display().to_string()))
}

/// Name that selects no network.
const NONE: &str = "none";

/// Whether `--weights` selects no network: a constant, a guide, and a field along the colours of the image.
pub fn names_no_network(path: Option<&Path>) -> bool {
    path.is_some_and(|path| path == Path::new(NONE) && !path.exists())
}

/// Returns the settings of the fit of weights; without a network, those of the default weights.
///
/// # Errors
/// As for [`open_weights`].
pub fn weights_fit(path: Option<&Path>) -> Result<FitConfig> {
    let path = path.filter(|_| !names_no_network(path));
    Ok(open_weights(path)?.fit()?.unwrap_or_default())
}

/// Returns a short name of the weights that [`open_weights`] would read; it depends on every bit of them.
///
/// # Errors
/// The file cannot be read.
pub fn weights_name(path: Option<&Path>) -> Result<String> {
    if names_no_network(path) {
        return Ok("no network".to_owned());
    }
    let (bytes, name) = read(path)?;
    let origin = match bytes {
        Cow::Borrowed(_) => " of the program",
        Cow::Owned(_) => "",
    };
    Ok(format!("`{name}`{origin}, {}", hash_text(&bytes)))
}

/// Returns the hash of the contents of the weights that [`open_weights`] would read, regardless of their path.
///
/// # Errors
/// The file cannot be read.
pub fn weights_hash(path: Option<&Path>) -> Result<String> {
    if names_no_network(path) {
        return Ok(NONE.to_owned());
    }
    Ok(hash_text(&read(path)?.0))
}

/// Returns the weights of the program with these contents, a [`weights_hash`].
pub fn embedded_with(contents: &str) -> Option<&'static Embedded> {
    static HASHES: LazyLock<Vec<String>> = LazyLock::new(|| {
        let all = embedded().iter();
        all.map(|weights| hash_text(weights.bytes)).collect()
    });
    let index = HASHES.iter().position(|hash| hash == contents)?;
    embedded().get(index)
}

fn hash_text(bytes: &[u8]) -> String {
    format!("{:016x}", hash(&[bytes]))
}

/// Reads weights from a file, or those of the program by name or by default.
///
/// # Errors
/// The file cannot be read or is not a weights file.
pub fn open_weights(path: Option<&Path>) -> Result<Weights> {
    let (bytes, name) = read(path)?;
    if is_system(&bytes) {
        return Err(Error::weights(format!(
            "`{name}` holds no basis functions, but a system that is compared with"
        ))
        .hint("give --method s2d, cspn or lsk; `lsdc weights info` says which it is"));
    }
    Weights::from_bytes(&bytes).map_err(|e| Error::of_core(e, format!("`{name}`")))
}

/// Opens weights from a file, or those of the program, for the CPU; `none` selects no network. Their scenes are not guided:
/// see [`guided_by_head`](crate::guided_by_head).
///
/// # Errors
/// The file cannot be read or is not a weights file, or a required encoder is not installed.
pub fn open_completer(path: Option<&Path>) -> Result<Completer> {
    if names_no_network(path) {
        return Ok(Completer::without_network(weights_fit(path)?)?);
    }
    completer(&open_weights(path)?)
}

/// Metadata key that only files of the systems have that this method is compared with.
pub const SYSTEM_NOTE: &str = "system";

/// Whether a file contains weights of such a system, judging by its header.
pub fn is_system(bytes: &[u8]) -> bool {
    SafeTensors::read_metadata(bytes).is_ok_and(|(_, metadata)| {
        let about = metadata.metadata().as_ref();
        about.is_some_and(|about| about.contains_key(SYSTEM_NOTE))
    })
}
