//! The run's record of numbers: one JSON object a line.

use lsdc_eval::data::write_atomically;
use lsdc_eval::metrics::Scores;
use lsdc_files::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::io::Write as _;
use std::path::{Path, PathBuf};

const FILE: &str = "metrics.jsonl";

/// What happens during a run; also the lines of `metrics.jsonl`.
#[derive(Clone, Copy, Debug, Serialize)]
#[serde(rename_all = "lowercase", untagged)]
pub enum TrainingEvent {
    /// A step was made.
    Step {
        /// Steps so far.
        step: usize,
        /// The weighted sum of the losses.
        loss: f64,
        /// Mean absolute error in metres.
        l1: f64,
        /// Root of the mean squared error in metres, over the batch.
        rmse: f64,
        /// The learning rate.
        rate: f64,
        /// Duration of the step.
        seconds: f64,
    },
    /// The frames kept out of training were completed from 500 points.
    Measured {
        /// Steps so far.
        step: usize,
        /// Mean scores.
        held_out: Scores,
    },
}

/// A line of `metrics.jsonl`, as far as runs read it.
#[derive(Deserialize)]
struct Line {
    step: usize,
    #[serde(default)]
    seconds: f64,
}

/// The sum of the times of all steps of a run.
pub(super) fn seconds(run: &Path) -> Result<f64> {
    let path = run.join(FILE);
    let text = std::fs::read_to_string(&path).map_err(|e| Error::read(&path, e))?;
    let lines = text.lines();
    let lines = lines.filter_map(|line| serde_json::from_str::<Line>(line).ok());
    Ok(lines.map(|line| line.seconds).sum())
}

/// Appends to `metrics.jsonl`.
pub(super) struct Log {
    path: PathBuf,
    file: std::fs::File,
}

impl Log {
    /// Opens the log of a run that goes on after `step`; later lines are dropped.
    pub(super) fn open(run: &Path, step: usize) -> Result<Self> {
        let path = run.join(FILE);
        if let Ok(text) = std::fs::read_to_string(&path) {
            let earlier = |line: &&str| {
                serde_json::from_str::<Line>(line).is_ok_and(|line| line.step <= step)
            };
            let lines: Vec<&str> = text.lines().filter(earlier).collect();
            write_atomically(&path, |out| {
                lines.iter().try_for_each(|line| writeln!(out, "{line}"))
            })?;
        }
        let file = std::fs::OpenOptions::new()
            .create(true)
            .append(true)
            .open(&path)
            .map_err(|e| Error::write(&path, e))?;
        Ok(Self { path, file })
    }

    pub(super) fn add(&mut self, event: &TrainingEvent) -> Result<()> {
        let write = |e: std::io::Error| Error::write(&self.path, e);
        let line = serde_json::to_string(event).map_err(|e| write(e.into()))?;
        writeln!(self.file, "{line}").map_err(write)
    }
}
