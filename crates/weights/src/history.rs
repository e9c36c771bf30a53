//! The origin of weights: a record in their file, with an entry for every command that made or changed them.

use crate::error::{Error, Result};
use crate::{embedded, open_weights, provenance, weights_hash};
use lsdc_core::Weights;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::{Display, Formatter};
use std::path::Path;

/// Note of a weights file with the entries, the oldest first.
const NOTE: &str = "history";

/// One command that made or changed the weights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HistoryEntry {
    /// The command.
    #[serde(rename = "by")]
    pub command: String,
    /// Version and numerics of the program.
    pub program: Value,
    /// Weights that it started or learned from.
    #[serde(rename = "of", default)]
    pub sources: Vec<SourceWeights>,
    /// Training frames.
    #[serde(default)]
    pub data: Value,
    /// All settings, including seeds.
    #[serde(default)]
    pub settings: Value,
    /// Computing time in seconds, without interruptions.
    #[serde(default)]
    pub seconds: f64,
    /// Time of completion, as ISO 8601 in UTC.
    pub ended: String,
}

/// Weights from which others were made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SourceWeights {
    /// Role: `start`, `teacher`, `backbone`.
    pub role: String,
    /// Given name: a file, or a name of the program.
    pub weights: String,
    /// Hash of the contents.
    pub contents: String,
    /// History of these weights, unless it is in the entries before this one.
    #[serde(default)]
    pub history: Vec<HistoryEntry>,
}

impl HistoryEntry {
    /// Creates the entry of a command that ends now.
    pub fn now(command: &str) -> Self {
        Self {
            command: command.to_owned(),
            program: provenance::program(),
            sources: Vec::new(),
            data: Value::Null,
            settings: Value::Null,
            seconds: 0.0,
            ended: provenance::now(),
        }
    }
}

impl SourceWeights {
    /// Records weights without their history, which is in the entries before.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn without_history(role: &str, path: Option<&Path>) -> Result<Self> {
        let first = embedded().first().map_or("default", |weights| weights.name);
        let name = path.unwrap_or(Path::new(first));
        Ok(Self {
            role: role.to_owned(),
            weights: name.display().to_string(),
            contents: weights_hash(path)?,
            history: Vec::new(),
        })
    }

    /// Records weights with their history.
    ///
    /// # Errors
    /// The file cannot be read, or is not a weights file.
    pub fn open(role: &str, path: &Path) -> Result<Self> {
        Ok(Self {
            history: read(&open_weights(Some(path))?.notes)?,
            ..Self::without_history(role, Some(path))?
        })
    }
}

/// Returns the entries in the notes of weights, the oldest first; none if there is no such note.
///
/// # Errors
/// The record cannot be read.
pub fn read(notes: &BTreeMap<String, String>) -> Result<Vec<HistoryEntry>> {
    let Some(json) = notes.get(NOTE) else {
        return Ok(Vec::new());
    };
    serde_json::from_str(json).map_err(|e| {
        Error::weights("the record of what the weights were made from cannot be read").because(e)
    })
}

/// Appends entries to the record.
///
/// # Errors
/// The existing record cannot be read.
pub fn add(
    notes: &mut BTreeMap<String, String>,
    entries: impl IntoIterator<Item = HistoryEntry>,
) -> Result<()> {
    let mut history = read(notes)?;
    history.extend(entries);
    let json = serde_json::to_string(&history)
        .map_err(|e| Error::weights("the record cannot be written as JSON").because(e))?;
    notes.insert(NOTE.to_owned(), json);
    Ok(())
}

/// Creates the entry of a command that changed weights, which it read from `path`.
///
/// # Errors
/// The file cannot be read.
pub fn changed(command: &str, path: Option<&Path>, weights: &Weights) -> Result<HistoryEntry> {
    let fit = weights.fit()?;
    Ok(HistoryEntry {
        sources: vec![SourceWeights::without_history("start", path)?],
        settings: serde_json::json!({ "fit": fit }),
        ..HistoryEntry::now(command)
    })
}

/// Formats the entries as lines; entries of source weights follow the entry that used them.
pub fn lines(history: &[HistoryEntry]) -> Vec<String> {
    let mut lines = Vec::new();
    for entry in history {
        lines.push(entry.to_string());
        for source in &entry.sources {
            let below = self::lines(&source.history).into_iter();
            lines.extend(below.map(|line| format!("  {}: {line}", source.role)));
        }
    }
    lines
}

impl Display for HistoryEntry {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}, {}", self.ended, self.command)?;
        if let Some(version) = self.program["version"].as_str() {
            write!(f, ", lsdc {version}")?;
        }
        let train = &self.settings["train"];
        if let (Some(steps), Some(batch)) = (train["steps"].as_u64(), train["batch"].as_u64()) {
            write!(f, ", {steps} steps of {batch} images")?;
        }
        let seed = train["seed"].as_u64().or(self.settings["seed"].as_u64());
        if let Some(seed) = seed {
            write!(f, ", seed {seed}")?;
        }
        if let (Some(found), Some(frames)) =
            (self.data["found"].as_str(), self.data["frames"].as_u64())
        {
            write!(f, ", {frames} frames of {found}")?;
        }
        for source in &self.sources {
            write!(f, ", {} `{}`", source.role, source.weights)?;
        }
        if self.seconds > 0.0 {
            write!(f, ", {:.0} s", self.seconds)?;
        }
        Ok(())
    }
}
