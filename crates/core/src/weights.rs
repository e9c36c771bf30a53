//! Weights files: safetensors with metadata on what the weights belong to.

use crate::error::{Result, SettingsError, WeightsError};
use crate::fit::{ErrorModel, FitConfig, NoisePrior, Prior};
use crate::network::NetworkConfig;
pub use crate::tensor::Tensor;
use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView};
use serde::de::{DeserializeOwned, IgnoredAny};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// The normalisation of colours before they enter the network.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Normalisation {
    /// Subtracted from colours in `[0, 1]`.
    pub mean: [f32; 3],
    /// Divisor of the colours after the mean is subtracted.
    pub deviation: [f32; 3],
    /// Height and width of the training images: the size at which the network works best.
    pub input: [usize; 2],
}

impl Default for Normalisation {
    /// The statistics of `ImageNet` and the size of NYU's evaluation.
    fn default() -> Self {
        Self {
            mean: [0.485, 0.456, 0.406],
            deviation: [0.229, 0.224, 0.225],
            input: [228, 304],
        }
    }
}

impl Normalisation {
    /// Height and width at which the network works on an image of `size`: about as many pixels as the training images
    /// have, in the image's proportions.
    pub(crate) fn working_size(&self, (height, width): (usize, usize)) -> (usize, usize) {
        let [rows, columns] = self.input;
        let scale = ((rows * columns) as f64 / (width as f64 * height as f64)).sqrt();
        let side = |length: usize| ((length as f64 * scale).round() as usize).max(1);
        (side(height), side(width))
    }

    /// Checks every number.
    ///
    /// # Errors
    /// A mean or deviation that cannot be used, or an implausible size.
    pub fn check(&self) -> Result<(), SettingsError> {
        /// Pixels along an axis.
        const MOST: usize = 1 << 14;
        let colours = self.mean.iter().all(|v| v.is_finite())
            && self.deviation.iter().all(|v| *v > 0.0 && v.is_finite());
        if !colours {
            return Err(SettingsError::new(
                "`normalisation`: means must be finite and deviations above 0",
            ));
        }
        if self.input.iter().all(|side| (1..=MOST).contains(side)) {
            Ok(())
        } else {
            Err(SettingsError::new(format!(
                "`normalisation.input` must be from 1 to {MOST} pixels along each axis"
            )))
        }
    }
}

/// Quantities estimated for the basis functions after training.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// The prior over the noise.
    pub noise: NoisePrior,
    /// Calibration factor from the standard deviations of the fit to those of the errors, for fits to which `errors` does not
    /// apply.
    pub deviation: f64,
    /// The distribution of the errors of the joint fit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub errors: Option<ErrorModel>,
}

/// A trained network with its preprocessing, the settings of the fit, and the prior over the weights of its basis functions.
///
/// ```
/// use lsdc_core::Weights;
/// # fn main() -> Result<(), lsdc_core::Error> {
/// # #[cfg(feature = "weights")] {
/// let weights = Weights::builtin();
/// assert!(weights.parameters() > 1_000_000);
/// # }
/// # Ok(())
/// # }
/// ```
#[derive(Clone, PartialEq)]
#[non_exhaustive]
pub struct Weights {
    /// The sizes of the network.
    #[doc(hidden)]
    pub network: NetworkConfig,
    /// The preprocessing.
    #[doc(hidden)]
    pub normalisation: Normalisation,
    /// Settings of other parts, as JSON by name (`fit`, `training`).
    #[doc(hidden)]
    pub notes: BTreeMap<String, String>,
    /// Arrays of other parts, by name.
    #[doc(hidden)]
    pub tables: BTreeMap<String, Tensor>,
    /// The tensors of the network, by name.
    #[doc(hidden)]
    pub tensors: BTreeMap<String, Tensor>,
}

/// The prefix of the names of tables in a file.
pub const TABLE: &str = "table.";
/// The name of a metadata record that every file has: the sizes of the network.
pub const NETWORK: &str = "network";
/// The name of another required record: the normalisation.
pub const NORMALISATION: &str = "normalisation";
/// The name of another required record: the version of the program that wrote the file.
pub const VERSION: &str = "lsdc";
/// Largest number of pixels of the training images.
const LARGEST_INPUT: usize = 1 << 23;
/// Name of the note that holds a `FitConfig`.
const FIT: &str = "fit";
/// Name of the note that holds a `Calibration`.
const CALIBRATION: &str = "calibration";
/// Names of the tables that hold a prior.
const MEAN: &str = "prior.mean";
const FACTOR: &str = "prior.factor";
const POOLED: &str = "prior.pooled";

impl std::fmt::Debug for Weights {
    /// Omits the values, of which there are millions.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Weights")
            .field("network", &self.network)
            .field("parameters", &self.parameters())
            .finish_non_exhaustive()
    }
}

impl Weights {
    /// The tensors of a network, without a fit or a prior.
    #[doc(hidden)]
    pub fn new(
        network: NetworkConfig,
        normalisation: Normalisation,
        tensors: BTreeMap<String, Tensor>,
    ) -> Self {
        Self {
            network,
            normalisation,
            notes: BTreeMap::new(),
            tables: BTreeMap::new(),
            tensors,
        }
    }

    /// The most accurate weights built into this crate.
    ///
    /// # Panics
    /// Never: the tests of the crate read them.
    #[cfg(feature = "weights")]
    pub fn builtin() -> Self {
        Self::embedded(DEFAULT)
    }

    /// Smaller, less accurate weights for low-power machines: two thirds of the run time.
    ///
    /// # Panics
    /// Never: the tests of the crate read them.
    #[cfg(feature = "weights-small")]
    pub fn builtin_small() -> Self {
        Self::embedded(SMALL)
    }

    #[cfg(feature = "weights-small")]
    #[allow(clippy::expect_used)]
    fn embedded(bytes: &[u8]) -> Self {
        Self::from_bytes(bytes).expect("weights of this crate are sound")
    }

    /// Reads a weights file.
    ///
    /// # Errors
    /// A file that cannot be read or is not a weights file.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let bytes = std::fs::read(path).map_err(|source| WeightsError::Read {
            path: path.to_owned(),
            source,
        })?;
        Self::from_bytes(&bytes)
    }

    /// Reads the bytes of a weights file. They are untrusted: declared sizes are compared with the length before memory is
    /// allocated.
    ///
    /// # Errors
    /// Bytes that are not a safetensors file with the metadata that lsdc writes, numbers that are not
    /// finite, or sizes that are out of range.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self> {
        let file = SafeTensors::deserialize(bytes).map_err(WeightsError::Format)?;
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(WeightsError::Format)?;
        let mut notes: BTreeMap<String, String> = match header.metadata() {
            Some(metadata) => metadata.clone().into_iter().collect(),
            None => return Err(WeightsError::record(NETWORK, "it has no metadata").into()),
        };
        let mut take = |name: &str| {
            notes
                .remove(name)
                .ok_or_else(|| WeightsError::record(name, "it is missing"))
        };
        let network = parsed_network(&take(NETWORK)?)?;
        let normalisation: Normalisation = parsed(NORMALISATION, &take(NORMALISATION)?)?;
        take(VERSION)?;
        network.check()?;
        normalisation.check()?;
        // A file must not cause allocations of tens of gigabytes; a user may.
        if normalisation.input[0] * normalisation.input[1] > LARGEST_INPUT {
            let reason = format!("images of more than {LARGEST_INPUT} pixels are implausible");
            return Err(WeightsError::record(NORMALISATION, reason).into());
        }
        let mut weights = Self {
            notes,
            ..Self::new(network, normalisation, BTreeMap::new())
        };
        for (name, view) in file.tensors() {
            let tensor = decode(&view)
                .ok_or_else(|| WeightsError::tensor(&name, "is neither of f16 nor of f32"))?;
            if !tensor.values.iter().all(|v| v.is_finite()) {
                return Err(WeightsError::tensor(&name, "has values that are not finite").into());
            }
            match name.strip_prefix(TABLE) {
                Some(table) => weights.tables.insert(table.to_owned(), tensor),
                None => weights.tensors.insert(name, tensor),
            };
        }
        Ok(weights)
    }

    /// The number of trained parameters of the network.
    pub fn parameters(&self) -> usize {
        let trained = self.tensors.iter().filter(|(name, _)| !is_statistic(name));
        trained.map(|(_, tensor)| tensor.values.len()).sum()
    }

    /// The settings of the fit stored with the weights.
    ///
    /// # Errors
    /// Metadata that cannot be parsed, or settings that are out of range.
    pub fn fit(&self) -> Result<Option<FitConfig>> {
        let fit: Option<FitConfig> = self.note(FIT)?;
        fit.as_ref().map_or(Ok(()), FitConfig::check)?;
        Ok(fit)
    }

    /// The prior and calibration stored with the weights, if any.
    ///
    /// # Errors
    /// Metadata that cannot be parsed, or a damaged prior.
    #[doc(hidden)]
    pub fn prior(&self) -> Result<Option<(Prior, Calibration)>> {
        let tables = [MEAN, FACTOR].map(|name| self.tables.get(name));
        let calibration: Option<Calibration> = self.note(CALIBRATION)?;
        let ([Some(mean), Some(factor)], Some(calibration)) = (tables, calibration) else {
            return Ok(None);
        };
        if !(calibration.deviation > 0.0 && calibration.deviation.is_finite()) {
            let what = "the factor of standard deviations is not above 0";
            return Err(WeightsError::record(CALIBRATION, what).into());
        }
        calibration
            .errors
            .as_ref()
            .map_or(Ok(()), ErrorModel::check)?;
        let mut prior = Prior::new(&mean.values, &factor.values, calibration.noise)?;
        if let Some(pooled) = self.tables.get(POOLED) {
            prior = prior.with_pooled(&pooled.values)?;
        }
        if prior.columns() != self.network.bases + 1 {
            let (found, bases) = (prior.columns(), self.network.bases);
            let what = format!("is one of {found} functions, not of {bases} and the constant");
            return Err(WeightsError::Prior(what).into());
        }
        Ok(Some((prior, calibration)))
    }

    /// Stores settings of the fit with the weights.
    #[doc(hidden)]
    pub fn record_fit(&mut self, fit: &FitConfig) {
        self.keep(FIT, fit);
    }

    /// Stores a prior and a calibration of standard deviations with the weights.
    #[doc(hidden)]
    pub fn record_prior(&mut self, prior: &Prior, deviation: f64, errors: Option<ErrorModel>) {
        let (mean, factor) = prior.numbers();
        let columns = mean.len();
        let rank = factor.len() / columns.max(1);
        for (name, shape, values) in [
            (MEAN, vec![columns], Some(mean)),
            (FACTOR, vec![columns, rank], Some(factor)),
            (POOLED, vec![columns], prior.pooled()),
        ] {
            match values {
                Some(values) => self
                    .tables
                    .insert(name.to_owned(), Tensor { shape, values }),
                None => self.tables.remove(name),
            };
        }
        let noise = prior.noise();
        let calibration = Calibration {
            noise,
            deviation,
            errors,
        };
        self.keep(CALIBRATION, &calibration);
    }

    fn note<T: DeserializeOwned>(&self, name: &str) -> Result<Option<T>, WeightsError> {
        let note = self.notes.get(name);
        note.map(|json| parsed(name, json)).transpose()
    }

    fn keep<T: Serialize>(&mut self, name: &str, value: &T) {
        // Plain structs of numbers and names can always be serialised.
        let json = serde_json::to_string(value).unwrap_or_default();
        self.notes.insert(name.to_owned(), json);
    }
}

/// The most accurate weights built into this crate, as a file.
#[cfg(feature = "weights")]
pub static DEFAULT: &[u8] = include_bytes!("../weights/default.safetensors");
/// The weights for low-power machines, as a file.
#[cfg(feature = "weights-small")]
pub static SMALL: &[u8] = include_bytes!("../weights/small.safetensors");

/// Whether a tensor holds running statistics, not trained parameters.
pub fn is_statistic(name: &str) -> bool {
    name.contains(".running_")
}

/// Parses the sizes of the network; an error for networks that only earlier versions support.
fn parsed_network(json: &str) -> Result<NetworkConfig, WeightsError> {
    #[derive(Deserialize)]
    struct Earlier {
        adapters: Option<IgnoredAny>,
    }
    if parsed::<Earlier>(NETWORK, json)?.adapters.is_some() {
        return Err(WeightsError::Removed {
            what: "adapters of their pretrained encoder",
            until: "0.2.0",
        });
    }
    parsed(NETWORK, json)
}

fn parsed<T: DeserializeOwned>(name: &str, json: &str) -> Result<T, WeightsError> {
    serde_json::from_str(json).map_err(|error| WeightsError::record(name, error))
}

fn decode(view: &TensorView<'_>) -> Option<Tensor> {
    let values = match view.dtype() {
        Dtype::F16 => {
            let (pairs, _) = view.data().as_chunks::<2>();
            let value = |b: &[u8; 2]| half::f16::from_le_bytes(*b).to_f32();
            pairs.iter().map(value).collect()
        }
        Dtype::F32 => {
            let (words, _) = view.data().as_chunks::<4>();
            words.iter().map(|b| f32::from_le_bytes(*b)).collect()
        }
        _ => return None,
    };
    Tensor::new(view.shape().to_vec(), values)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_prior_that_is_kept_replaces_all_of_the_one_before() {
        let mut weights = Weights::builtin_small();
        let (prior, calibration) = weights.prior().unwrap().unwrap();
        let columns = prior.columns();
        let centres: Vec<f32> = (0..columns).map(|i| 0.1 * i as f32).collect();
        let centred = prior.clone().with_pooled(&centres).unwrap();
        weights.record_prior(&centred, calibration.deviation, None);
        assert_eq!(weights.prior().unwrap().unwrap().0, centred);

        let (mean, factor) = prior.numbers();
        let plain = Prior::new(&mean, &factor, prior.noise()).unwrap();
        weights.record_prior(&plain, calibration.deviation, None);
        assert_eq!(weights.prior().unwrap().unwrap().0, plain);
    }

    /// Weights from versions up to 0.2.0 name the fitted function of depth.
    #[test]
    fn a_fit_of_another_function_of_depth_is_refused() {
        let mut weights = Weights::builtin_small();
        let fit = weights.fit().unwrap().unwrap();
        let stored = |space: &str| {
            let mut note = serde_json::to_value(fit).unwrap();
            note["space"] = space.into();
            note.to_string()
        };
        weights.notes.insert(FIT.to_owned(), stored("depth"));
        assert_eq!(weights.fit().unwrap(), Some(fit));
        for space in ["log", "inverse"] {
            weights.notes.insert(FIT.to_owned(), stored(space));
            let error = weights.fit().unwrap_err().to_string();
            assert!(error.contains("until 0.2.0"), "{error}");
        }
    }
}
