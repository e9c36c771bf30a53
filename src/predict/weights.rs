//! Weights files, and what this program keeps in them beside the network.

use crate::error::{Error, Result};
use crate::fit::{FitConfig, NoisePrior, Prior};
use crate::model::{Table, Weights};
use crate::rng::hash;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Weights that come with the program.
#[derive(Clone, Copy, Debug)]
pub struct Embedded {
    /// What `--weights` takes.
    pub name: &'static str,
    /// What they are for.
    pub about: &'static str,
    /// A safetensors file.
    pub bytes: &'static [u8],
}

/// All of them; the first is used unless another is asked for.
const EMBEDDED: [Embedded; 2] = [
    Embedded {
        name: "default",
        about: "the most accurate",
        bytes: include_bytes!("../../assets/weights.safetensors"),
    },
    Embedded {
        name: "small",
        about: "for weak machines",
        bytes: include_bytes!("../../assets/small.safetensors"),
    },
];

/// The weights that come with the program, the default first.
pub fn embedded() -> &'static [Embedded] {
    &EMBEDDED
}

/// Weights of the program by their name; a file of that name takes precedence.
fn named(path: Option<&Path>) -> Option<&'static Embedded> {
    match path {
        None => EMBEDDED.first(),
        Some(path) if path.exists() => None,
        Some(path) => EMBEDDED.iter().find(|w| Path::new(w.name) == path),
    }
}

/// The note that holds a `FitConfig`.
const FIT: &str = "fit";
/// The note that holds a `Calibration`.
const CALIBRATION: &str = "calibration";
/// The tables that hold a prior.
const MEAN: &str = "prior.mean";
const FACTOR: &str = "prior.factor";

/// What was learned about the base functions once they were trained.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// What is known of the noise before any depth is seen.
    pub noise: NoisePrior,
    /// Standard deviations of pixels, as they come from the fit, times this are those of the
    /// errors.
    pub deviation: f64,
}

/// The settings of the fit that the weights were made for.
///
/// # Errors
/// A record that cannot be read.
pub fn recorded_fit(weights: &Weights) -> Result<Option<FitConfig>> {
    note(weights, FIT)
}

/// Keeps settings of the fit in the weights.
///
/// # Errors
/// Settings that cannot be written as JSON.
pub fn record_fit(weights: &mut Weights, fit: &FitConfig) -> Result<()> {
    keep(weights, FIT, fit)
}

/// The prior and calibration that the weights hold, if any.
///
/// # Errors
/// A record that cannot be read.
pub fn recorded_prior(weights: &Weights) -> Result<Option<(Prior, Calibration)>> {
    let tables = [MEAN, FACTOR].map(|name| weights.tables.get(name));
    match (tables, note::<Calibration>(weights, CALIBRATION)?) {
        ([Some(mean), Some(factor)], Some(calibration)) => {
            let prior = Prior::new(&mean.values, &factor.values, calibration.noise)?;
            Ok(Some((prior, calibration)))
        }
        _ => Ok(None),
    }
}

/// Keeps a prior and a calibration in the weights.
///
/// # Errors
/// Numbers that cannot be written as JSON.
pub fn record_prior(weights: &mut Weights, prior: &Prior, deviation: f64) -> Result<()> {
    let (mean, factor) = prior.numbers();
    let columns = mean.len();
    let rank = factor.len() / columns.max(1);
    let mut table = |name: &str, shape: Vec<usize>, values: Vec<f32>| {
        weights
            .tables
            .insert(name.to_owned(), Table { shape, values });
    };
    table(MEAN, vec![columns], mean);
    table(FACTOR, vec![columns, rank], factor);
    let noise = prior.noise();
    keep(weights, CALIBRATION, &Calibration { noise, deviation })
}

fn note<T: DeserializeOwned>(weights: &Weights, name: &str) -> Result<Option<T>> {
    let read = |json: &String| {
        serde_json::from_str(json).map_err(|e| {
            Error::weights(format!("the `{name}` record of the weights cannot be read")).because(e)
        })
    };
    weights.record.notes.get(name).map(read).transpose()
}

fn keep<T: Serialize>(weights: &mut Weights, name: &str, value: &T) -> Result<()> {
    let json = serde_json::to_string(value)
        .map_err(|e| Error::weights(format!("the `{name}` record cannot be written")).because(e))?;
    weights.record.notes.insert(name.to_owned(), json);
    Ok(())
}

/// A short name of the weights that [`open_weights`] would read: changes with every bit of them.
///
/// # Errors
/// A file that cannot be read.
pub fn weights_name(path: Option<&Path>) -> Result<String> {
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
        return Weights::from_bytes(own.bytes, own.name);
    }
    let path = path.unwrap_or(Path::new(""));
    Weights::from_bytes(&read(path)?, &path.display().to_string())
}

fn read(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).map_err(|e| {
        let names: Vec<&str> = EMBEDDED.iter().map(|w| w.name).collect();
        Error::read(path, e).hint(format!(
            "give a weights file, or one of the program's: {}",
            names.join(", ")
        ))
    })
}
