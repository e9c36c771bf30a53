//! Weights by name or from a file.

use crate::error::{Error, Result};
use crate::{Embedded, completer, embedded};
use lsdc_core::fit::FitConfig;
use lsdc_core::{Completer, Weights};
use lsdc_rng::hash;
use safetensors::SafeTensors;
use std::path::Path;

/// Weights of the program by their name; a file of that name takes precedence.
fn named(path: Option<&Path>) -> Option<&'static Embedded> {
    match path {
        None => embedded().first(),
        Some(path) if path.exists() => None,
        Some(path) => crate::named(path.to_str()?),
    }
}

/// The name that stands for no network at all.
const NONE: &str = "none";

/// Whether `--weights` asks for no network at all: a constant, a guide, and a field along the colours of the image.
pub fn are_none(path: Option<&Path>) -> bool {
    path.is_some_and(|path| path == Path::new(NONE) && !path.exists())
}

/// The settings of the fit of weights; without a network, those of the default weights.
///
/// # Errors
/// As for [`open_weights`].
pub fn weights_fit(path: Option<&Path>) -> Result<FitConfig> {
    let path = path.filter(|_| !are_none(path));
    Ok(open_weights(path)?.fit()?.unwrap_or_default())
}

/// A short name of the weights that [`open_weights`] would read: changes with every bit of them.
///
/// # Errors
/// A file that cannot be read.
pub fn weights_name(path: Option<&Path>) -> Result<String> {
    if are_none(path) {
        return Ok("no network".to_owned());
    }
    let of = match (named(path), path) {
        (Some(own), _) => format!("`{}` of the program", own.name),
        (None, path) => format!("`{}`", path.unwrap_or(Path::new("")).display()),
    };
    Ok(format!("{of}, {}", weights_hash(path)?))
}

/// The weights that [`open_weights`] would read by their contents alone, wherever they lie.
///
/// # Errors
/// A file that cannot be read.
pub fn weights_hash(path: Option<&Path>) -> Result<String> {
    if are_none(path) {
        return Ok(NONE.to_owned());
    }
    let hashed = |bytes: &[u8]| format!("{:016x}", hash(&[bytes]));
    match named(path) {
        Some(own) => Ok(hashed(own.bytes)),
        None => Ok(hashed(&read(path.unwrap_or(Path::new("")))?)),
    }
}

/// Weights from a file, or of the program: by name, or the default.
///
/// # Errors
/// A file that cannot be read or is no weights file.
pub fn open_weights(path: Option<&Path>) -> Result<Weights> {
    if let Some(own) = named(path) {
        return read_bytes(own.bytes, own.name);
    }
    let path = path.unwrap_or(Path::new(""));
    read_bytes(&read(path)?, &path.display().to_string())
}

/// Opens weights from a file, or those that come with the program, for the CPU; `none` is no network at all.
///
/// # Errors
/// A file that cannot be read or is no weights file, or an encoder that is not installed.
pub fn open_completer(path: Option<&Path>) -> Result<Completer> {
    if are_none(path) {
        return Ok(Completer::without_network(weights_fit(path)?)?);
    }
    completer(&open_weights(path)?)
}

/// The metadata that only files of the systems have that this method is compared with.
pub const SYSTEM_NOTE: &str = "system";

/// Whether a file holds weights of such a system, as far as can be told without reading all of it.
pub fn is_system(bytes: &[u8]) -> bool {
    SafeTensors::read_metadata(bytes).is_ok_and(|(_, metadata)| {
        let about = metadata.metadata().as_ref();
        about.is_some_and(|about| about.contains_key(SYSTEM_NOTE))
    })
}

fn read_bytes(bytes: &[u8], name: &str) -> Result<Weights> {
    if is_system(bytes) {
        return Err(Error::weights(format!(
            "`{name}` holds no basis functions, but a system that is compared with"
        ))
        .hint("give --method s2d, cspn or lsk; `lsdc weights info` says which it is"));
    }
    Weights::from_bytes(bytes).map_err(|e| Error::of_core(e, format!("`{name}`")))
}

fn read(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).map_err(|e| {
        let names: Vec<&str> = embedded().iter().map(|w| w.name).collect();
        Error::read(path, e).hint(format!(
            "give a weights file, or one of the program's: {}",
            names.join(", ")
        ))
    })
}
