//! The metrics log of a run: one JSON object per line.

use lsdc_eval::data::write_atomically;
use lsdc_eval::metrics::Scores;
use lsdc_files::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::io::Write as _;
use std::path::{Path, PathBuf};

const FILE: &str = "metrics.jsonl";

/// Events during a run, and the lines of `metrics.jsonl`.
#[derive(Clone, Copy, Debug, Serialize)]
#[serde(rename_all = "lowercase", untagged)]
pub enum TrainingEvent {
    /// A step was completed.
    Step {
        /// Number of steps so far.
        step: usize,
        /// Weighted sum of the losses.
        loss: f64,
        /// Mean absolute error in metres.
        l1: f64,
        /// Root mean squared error of the batch, in metres.
        rmse: f64,
        /// Learning rate.
        rate: f64,
        /// Duration of the step in seconds; the mean of steps whose losses are read together.
        seconds: f64,
    },
    /// Held-out frames were completed from 500 points.
    Measured {
        /// Number of steps so far.
        step: usize,
        /// Mean scores on held-out frames.
        held_out: Scores,
    },
}

/// The fields of a line of `metrics.jsonl` that runs read.
#[derive(Deserialize)]
struct Line {
    step: usize,
    #[serde(default)]
    seconds: f64,
}

/// Returns the total time of all steps of a run, in seconds.
pub(super) fn seconds(run: &Path) -> Result<f64> {
    let path = run.join(FILE);
    let text = std::fs::read_to_string(&path).map_err(|e| Error::read(&path, e))?;
    let lines = text.lines();
    let lines = lines.filter_map(|line| serde_json::from_str::<Line>(line).ok());
    Ok(lines.map(|line| line.seconds).sum())
}

/// A log that appends lines to `metrics.jsonl`.
pub(super) struct Log {
    path: PathBuf,
    file: std::fs::File,
}

impl Log {
    /// Opens the log of a run that resumes after `step`; later lines are dropped.
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
