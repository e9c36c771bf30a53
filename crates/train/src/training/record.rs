//! The provenance of trained weights.

use super::TrainConfig;
use super::log::seconds;
use lsdc_core::fit::Prior;
use lsdc_core::network::NetworkConfig;
use lsdc_files::error::Result;
use lsdc_weights::history::{self, HistoryEntry, SourceWeights};
use lsdc_weights::open_weights;
use lsdc_weights::{identity, read_tensors};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;

/// Collected before the first step, so that files deleted during the run are not needed.
pub struct TrainingRecord {
    /// History of the weights that the run starts from.
    before: Vec<HistoryEntry>,
    /// Network and prior of the weights that the run starts from.
    start: Option<(NetworkConfig, Prior)>,
    sources: Vec<SourceWeights>,
    data: Value,
    settings: Value,
}

impl TrainingRecord {
    pub(super) fn new(config: &TrainConfig, data: Value, settings: Value) -> Result<Self> {
        let (mut before, mut sources) = (Vec::new(), Vec::new());
        let mut prior = None;
        if let Some(start) = &config.start {
            let weights = open_weights(Some(start))?;
            before = history::read(&weights.notes)?;
            prior = weights.prior()?.map(|(prior, _)| (weights.network, prior));
            sources.push(SourceWeights::without_history("start", Some(start))?);
        }
        if let Some(path) = &config.backbone.pretrained {
            sources.push(SourceWeights {
                role: "backbone".to_owned(),
                weights: path.display().to_string(),
                contents: identity(&read_tensors(path)?),
                history: Vec::new(),
            });
        }
        if let Some(teacher) = &config.teacher {
            sources.push(teacher.source()?);
        }
        Ok(Self {
            before,
            start: prior,
            sources,
            data,
            settings,
        })
    }

    /// Returns the prior of the weights that the run starts from, if its functions match those of `network`.
    pub(super) fn start_prior(&self, network: &NetworkConfig) -> Option<&Prior> {
        let (start, prior) = self.start.as_ref()?;
        (start.bases == network.bases && start.mean == network.mean).then_some(prior)
    }

    /// Adds the record to the notes of weights after the last step of the run in `folder`.
    ///
    /// # Errors
    /// Notes or a log cannot be read.
    pub fn add_to(self, notes: &mut BTreeMap<String, String>, folder: &Path) -> Result<()> {
        let made = HistoryEntry {
            sources: self.sources,
            data: self.data,
            settings: self.settings,
            seconds: seconds(folder)?,
            ..HistoryEntry::now("train")
        };
        history::add(notes, self.before.into_iter().chain([made]))
    }
}
