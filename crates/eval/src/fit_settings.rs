//! Settings of a fit that override those of weights.

use lsdc_core::fit::FitConfig;
use lsdc_files::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::fmt::Display;

/// Some or all settings of a fit.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct FitSettings(pub toml::Table);

impl FitSettings {
    /// Returns all settings of a fit.
    ///
    /// # Errors
    /// None for a checked fit.
    pub fn all(fit: &FitConfig) -> Result<Self> {
        toml::Table::try_from(fit).map(Self).map_err(unfit)
    }

    /// Overrides the settings of a fit with the given ones.
    ///
    /// # Errors
    /// An unknown key, or a value out of range.
    pub fn over(&self, fit: &FitConfig) -> Result<FitConfig> {
        let Self(mut table) = Self::all(fit)?;
        merge(&mut table, self.0.clone());
        let fit: FitConfig = table.try_into().map_err(unfit)?;
        fit.check()?;
        Ok(fit)
    }
}

fn unfit(e: impl Display) -> Error {
    Error::config(format!("`fit`: {}", e.to_string().trim()))
        .hint("docs/fit.md explains every setting")
}

/// Merges `over` into `base`, table by table; values of `over` win.
pub fn merge(base: &mut toml::Table, over: toml::Table) {
    for (key, value) in over {
        match (base.get_mut(&key), value) {
            (Some(toml::Value::Table(base)), toml::Value::Table(over)) => merge(base, over),
            (_, value) => {
                base.insert(key, value);
            }
        }
    }
}
