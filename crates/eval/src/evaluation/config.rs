//! The settings of an evaluation.

use crate::metrics::Rules;
use crate::predict::Method;
use crate::sampling::{HoldOut, Noise, Pattern, Protocol, ProtocolPreset};
use lsdc_files::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// What is measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EvalConfig {
    /// A published protocol by name; the dataset's own if absent.
    pub preset: Option<String>,
    /// The protocol in full; replaces the steps of `preset`.
    pub protocol: Option<Protocol>,
    /// Sparse points; those of the preset if absent.
    pub points: Option<Pattern>,
    /// What is held out of each frame: scored, and never given.
    pub hold_out: Option<HoldOut>,
    /// What is done to the sparse points.
    pub noise: Option<Noise>,
    /// Names the first draw of points; every method gets the same.
    pub seed: u64,
    /// Draws of points, with consecutive seeds.
    pub seeds: usize,
    /// Methods side by side.
    pub methods: Vec<Method>,
    /// Measure only the first frames.
    pub limit: Option<usize>,
    /// What the measures leave open.
    pub rules: Rules,
    /// The share of the predicted depth up to which a standard deviation counts as certain, in the rates of phantom and
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

    /// The names of the draws.
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
