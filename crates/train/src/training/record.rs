//! What the weights of a run tell of how they were made.

use super::TrainConfig;
use super::log::seconds;
use lsdc_files::error::Result;
use lsdc_weights::history::{self, Made, Source};
use lsdc_weights::open_weights;
use lsdc_weights::{identity, read_tensors};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;

/// Known before the first step, so that files which are gone after the last one are missed by nobody.
pub struct Record {
    /// Of the weights that it starts from.
    before: Vec<Made>,
    of: Vec<Source>,
    data: Value,
    settings: Value,
}

impl Record {
    pub(super) fn new(config: &TrainConfig, data: Value, settings: Value) -> Result<Self> {
        let (mut before, mut of) = (Vec::new(), Vec::new());
        if let Some(start) = &config.start {
            before = history::of(&open_weights(Some(start))?.notes)?;
            of.push(Source::told_before("start", Some(start))?);
        }
        if let Some(path) = &config.backbone.pretrained {
            of.push(Source {
                role: "backbone".to_owned(),
                weights: path.display().to_string(),
                contents: identity(&read_tensors(path)?),
                history: Vec::new(),
            });
        }
        if let Some(teacher) = &config.teacher {
            of.push(Source::open("teacher", &teacher.weights)?);
        }
        Ok(Self {
            before,
            of,
            data,
            settings,
        })
    }

    /// Adds it to the notes of weights whose run in `folder` has made its last step.
    ///
    /// # Errors
    /// Notes or a log that cannot be read.
    pub fn keep(self, notes: &mut BTreeMap<String, String>, folder: &Path) -> Result<()> {
        let made = Made {
            of: self.of,
            data: self.data,
            settings: self.settings,
            seconds: seconds(folder)?,
            ..Made::now("train")
        };
        history::add(notes, self.before.into_iter().chain([made]))
    }
}
