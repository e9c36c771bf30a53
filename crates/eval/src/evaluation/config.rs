//! The settings of an evaluation.

use crate::metrics::Rules;
use crate::predict::Method;
use crate::sampling::{HoldOut, Noise, Pattern, Protocol, ProtocolPreset};
use lsdc_files::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// Settings of an evaluation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EvalConfig {
    /// Name of a published protocol; the default of the dataset if absent.
    pub preset: Option<String>,
    /// Protocol in full; replaces the steps of `preset`.
    pub protocol: Option<Protocol>,
    /// Pattern of sparse points; that of the preset if absent.
    pub points: Option<Pattern>,
    /// Pixels held out of each frame: scored and never given.
    pub hold_out: Option<HoldOut>,
    /// Noise added to the sparse points.
    pub noise: Option<Noise>,
    /// Seed of the first draw of points; all methods get the same points.
    pub seed: u64,
    /// Number of draws of points, with consecutive seeds.
    pub seeds: usize,
    /// Methods to compare.
    pub methods: Vec<Method>,
    /// Limit of the number of frames; the first frames are used.
    pub limit: Option<usize>,
    /// Parameters of the metrics.
    pub rules: Rules,
    /// Largest standard deviation, as a fraction of the predicted depth, that counts as certain in the rates of phantom and
    /// missed obstacles.
    pub sigma_cut: f64,
}

impl Default for EvalConfig {
    fn default() -> Self {
        Self {
            preset: None,
            protocol: None,
            points: None,
            hold_out: None,
            noise: None,
            seed: 0,
            seeds: 1,
            methods: ["lsdc", "linear"]
                .into_iter()
                .filter_map(|m| m.parse().ok())
                .collect(),
            limit: None,
            rules: Rules::default(),
            sigma_cut: 0.1,
        }
    }
}

impl EvalConfig {
    /// Checks every setting.
    ///
    /// # Errors
    /// The first setting that is out of range.
    pub fn check(&self) -> Result<()> {
        if let Some(preset) = &self.preset {
            ProtocolPreset::named(preset)?;
        }
        self.protocol.as_ref().map_or(Ok(()), Protocol::check)?;
        if self.seeds == 0 || self.limit == Some(0) {
            return Err(Error::config(
                "`eval.seeds` and `eval.limit` must be above 0",
            ));
        }
        if !(self.sigma_cut > 0.0 && self.sigma_cut.is_finite()) {
            return Err(Error::config("`eval.sigma_cut` must be above 0"));
        }
        self.rules.check()
    }

    /// Returns the seeds of the draws.
    pub fn draws(&self) -> Vec<u64> {
        (0..self.seeds as u64)
            .map(|i| self.seed.wrapping_add(i))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_protocol_is_checked() {
        let of = |pixels| EvalConfig {
            protocol: Some(Protocol {
                pixels: Some(pixels),
                ..Protocol::default()
            }),
            ..EvalConfig::default()
        };
        assert!(of(50).check().is_ok());
        assert!(of(0).check().is_err());
    }
}
