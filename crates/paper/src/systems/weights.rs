//! Weights files of systems: safetensors with metadata.

use super::{SystemConfig, SystemNet};
use burn::tensor::Device;
use lsdc_core::weights::Normalisation;
use lsdc_core::weights::{NORMALISATION, Tensor as Table, VERSION};
use lsdc_files::error::{Error, Result};
use lsdc_rng::hash;
use lsdc_train::model::parameter_count;
use lsdc_train::model::parameters::tables;
use lsdc_train::model::weights::fill;
use lsdc_weights::SYSTEM_NOTE;
use lsdc_weights::{Precision, stored_bytes};
use safetensors::SafeTensors;
use safetensors::tensor::Dtype;
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

/// A trained system with its metadata.
#[derive(Clone, Debug)]
pub struct SystemWeights {
    /// System with its sizes.
    pub config: SystemConfig,
    /// Preprocessing of images.
    pub normalisation: Normalisation,
    /// Notes about the training, as JSON by name.
    pub notes: BTreeMap<String, String>,
    /// Tensors by name.
    tensors: BTreeMap<String, Table>,
    /// Hash of the file; empty if the weights do not come from a file.
    pub hash: String,
}

impl SystemWeights {
    /// Extracts the weights of a network.
    pub fn of(net: &SystemNet, config: SystemConfig, normalisation: Normalisation) -> Self {
        Self {
            tensors: tables(net),
            ..Self::empty(config, normalisation)
        }
    }

    /// Creates a record without weights, for a network that has its own.
    pub fn empty(config: SystemConfig, normalisation: Normalisation) -> Self {
        Self {
            config,
            normalisation,
            notes: BTreeMap::new(),
            tensors: BTreeMap::new(),
            hash: String::new(),
        }
    }

    /// Encodes a weights file.
    ///
    /// # Errors
    /// A record cannot be written as JSON.
    pub fn to_bytes(&self, precision: Precision) -> Result<Vec<u8>> {
        let broken = |e: &dyn std::fmt::Display| {
            Error::weights(format!("the weights cannot be written: {e}"))
        };
        let mut metadata: HashMap<String, String> = self.notes.clone().into_iter().collect();
        let config = serde_json::to_string(&self.config).map_err(|e| broken(&e))?;
        let normalisation = serde_json::to_string(&self.normalisation).map_err(|e| broken(&e))?;
        metadata.insert(VERSION.into(), env!("CARGO_PKG_VERSION").into());
        metadata.insert(SYSTEM_NOTE.into(), config);
        metadata.insert(NORMALISATION.into(), normalisation);
        let tensors = self.tensors.iter();
        stored_bytes(
            tensors.map(|(name, tensor)| (name.clone(), tensor, precision)),
            metadata,
        )
    }

    /// Reads a weights file.
    ///
    /// # Errors
    /// The file cannot be read, or does not contain weights of a system.
    pub fn open(path: &Path) -> Result<Self> {
        let bytes = std::fs::read(path).map_err(|e| Error::read(path, e))?;
        Self::from_bytes(&bytes, path)
    }

    fn from_bytes(bytes: &[u8], path: &Path) -> Result<Self> {
        let damaged = |what: &str| Error::format(path, what.to_owned());
        let file = SafeTensors::deserialize(bytes)
            .map_err(|e| damaged("is no safetensors file").because(e))?;
        let (_, metadata) = SafeTensors::read_metadata(bytes)
            .map_err(|e| damaged("has no readable metadata").because(e))?;
        let mut notes: BTreeMap<String, String> = metadata
            .metadata()
            .clone()
            .unwrap_or_default()
            .into_iter()
            .collect();
        notes.remove(VERSION);
        let config = notes.remove(SYSTEM_NOTE).ok_or_else(|| {
            damaged("holds no weights of s2d, cspn or lsk")
                .hint("weights of `lsdc` itself go with `--method lsdc`")
        })?;
        let config: SystemConfig = serde_json::from_str(&config)
            .map_err(|e| damaged("is of a system that is not known").because(e))?;
        config.check()?;
        let normalisation = notes.remove(NORMALISATION).unwrap_or_default();
        let normalisation: Normalisation = serde_json::from_str(&normalisation)
            .map_err(|e| damaged("does not say how colours are normalised").because(e))?;
        normalisation
            .check()
            .map_err(|e| damaged("has a normalisation out of range").because(e))?;
        let mut tensors = BTreeMap::new();
        for (name, view) in file.tensors() {
            let bytes = view.data();
            let values: Vec<f32> = match view.dtype() {
                Dtype::F32 => {
                    let (fours, _) = bytes.as_chunks::<4>();
                    fours.iter().map(|b| f32::from_le_bytes(*b)).collect()
                }
                Dtype::F16 => {
                    let (twos, _) = bytes.as_chunks::<2>();
                    let half = |b: &[u8; 2]| half::f16::from_le_bytes(*b).to_f32();
                    twos.iter().map(half).collect()
                }
                _ => return Err(damaged(&format!("`{name}` is neither f32 nor f16"))),
            };
            if values.iter().any(|v| !v.is_finite()) {
                return Err(damaged(&format!(
                    "`{name}` has a number that is not finite"
                )));
            }
            let table = Table::new(view.shape().to_vec(), values)
                .ok_or_else(|| damaged(&format!("`{name}` is damaged")))?;
            tensors.insert(name, table);
        }
        let count: usize = tensors.values().map(|table| table.values().len()).sum();
        if count < config.at_least() {
            return Err(damaged("holds fewer numbers than its system has"));
        }
        Ok(Self {
            config,
            normalisation,
            notes,
            tensors,
            hash: format!("{:016x}", hash(&[bytes])),
        })
    }

    /// Builds the network with its weights.
    ///
    /// # Errors
    /// A tensor is missing, unexpected or of the wrong shape.
    pub fn net(&self, device: &Device) -> Result<SystemNet> {
        fill(self.tensors.clone(), self.config.blank(device)?)
    }

    /// Returns the number of trained parameters.
    ///
    /// # Errors
    /// Settings out of range.
    pub fn parameters(&self) -> Result<usize> {
        Ok(parameter_count(&self.net(&Device::flex())?))
    }
}
