//! Evaluation of a run, and the notes of its weights file.

use super::record::TrainingRecord;
use super::run::{Subject, Trainer};
use super::truth::random_task;
use lsdc_eval::metrics::{Rules, ScoreAccumulator, Scores};
use lsdc_eval::predict::DepthCompleter;
use lsdc_files::error::{Cause, Error, Result};
use serde_json::{Value, json};
use std::path::PathBuf;

impl<S: Subject> Trainer<S> {
    /// Returns the scores on the held-out frames.
    ///
    /// # Errors
    /// Frames cannot be read or completed.
    pub(super) fn measure(&self, method: &dyn DepthCompleter) -> Result<Scores> {
        let mut accumulator = ScoreAccumulator::default();
        for &index in &self.held_out {
            let frame = self.config.protocol.apply(&self.frames.load(index)?)?;
            let task = random_task(&frame, 500, 0)?;
            let depth = method.depth(&frame.rgb, &task.sparse)?;
            accumulator.add(&Scores::of(&depth, &task.truth, &Rules::default())?);
        }
        Ok(accumulator.mean().unwrap_or_default())
    }

    /// Returns the scores on the held-out frames as a note for weights files; `None` without held-out frames.
    ///
    /// # Errors
    /// The errors of the method, or frames cannot be read or completed.
    pub fn scores_note(
        &self,
        method: impl FnOnce() -> Result<Box<dyn DepthCompleter>>,
    ) -> Result<Option<String>> {
        if self.held_out.is_empty() {
            return Ok(None);
        }
        let scores = self.measure(&*method()?)?;
        serde_json::to_string(&scores)
            .map(Some)
            .map_err(|e| Error::new(Cause::Write, "cannot encode the scores").because(e))
    }

    /// Returns the path of the resulting weights.
    pub fn weights_path(&self) -> PathBuf {
        self.folder.join("weights.safetensors")
    }

    /// Returns the training settings as a note for weights files.
    ///
    /// # Errors
    /// None for a checked configuration.
    pub fn note(&self) -> Result<String> {
        serde_json::to_string(&self.config)
            .map_err(|e| Error::new(Cause::Write, "cannot encode the settings").because(e))
    }

    /// Returns the record of the run for weights files; `settings` are those of its subject.
    pub(super) fn record(&self, mut settings: Value) -> Result<TrainingRecord> {
        settings["train"] = json!(self.config);
        settings["devices"] = json!(self.devices.len());
        TrainingRecord::new(&self.config, self.data.clone(), settings)
    }
}
