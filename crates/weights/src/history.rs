//! What weights were made from: a record inside their file, with an entry for every command that made or changed them.

use crate::error::{Error, Result};
use crate::{embedded, open_weights, provenance, weights_hash};
use lsdc_core::Weights;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::{Display, Formatter};
use std::path::Path;

/// The note of a weights file that holds the entries, the oldest first.
const NOTE: &str = "history";

/// One command that made or changed the weights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HistoryEntry {
    /// The command.
    #[serde(rename = "by")]
    pub command: String,
    /// The program and its numerics.
    pub program: Value,
    /// The weights that it started from, or learned from.
    #[serde(rename = "of", default)]
    pub sources: Vec<SourceWeights>,
    /// The frames.
    #[serde(default)]
    pub data: Value,
    /// All settings, seeds among them.
    #[serde(default)]
    pub settings: Value,
    /// Seconds of computing, without interruptions.
    #[serde(default)]
    pub seconds: f64,
    /// When it was over, as ISO 8601 in UTC.
    pub ended: String,
}

/// Weights that others were made from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SourceWeights {
    /// What they were: `start`, `teacher`, `backbone`.
    pub role: String,
    /// How they were called: a file, or a name of the program.
    pub weights: String,
    /// Changes with every bit of them.
    pub contents: String,
    /// What they were made from, unless the entries before this one are their history.
    #[serde(default)]
    pub history: Vec<HistoryEntry>,
}

impl HistoryEntry {
    /// The entry of a command that ends now.
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
    /// Weights of that name without their history, which is in the entries before.
    ///
    /// # Errors
    /// A file that cannot be read.
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

    /// Weights of that name.
    ///
    /// # Errors
    /// A file that cannot be read, or is no weights file.
    pub fn open(role: &str, path: &Path) -> Result<Self> {
        Ok(Self {
            history: read(&open_weights(Some(path))?.notes)?,
            ..Self::without_history(role, Some(path))?
        })
    }
}

/// The entries among the notes of weights, the oldest first; none if there is no such note.
///
/// # Errors
/// A record that cannot be read.
pub fn read(notes: &BTreeMap<String, String>) -> Result<Vec<HistoryEntry>> {
    let Some(json) = notes.get(NOTE) else {
        return Ok(Vec::new());
    };
    serde_json::from_str(json).map_err(|e| {
        Error::weights("the record of what the weights were made from cannot be read").because(e)
    })
}

/// Adds entries to those that there are.
///
/// # Errors
/// A record that cannot be read.
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

/// The entry of a command that changed weights, which it read from `path`.
///
/// # Errors
/// A file that cannot be read.
pub fn changed(command: &str, path: Option<&Path>, weights: &Weights) -> Result<HistoryEntry> {
    let fit = weights.fit()?;
    Ok(HistoryEntry {
        sources: vec![SourceWeights::without_history("start", path)?],
        settings: serde_json::json!({ "fit": fit }),
        ..HistoryEntry::now(command)
    })
}

/// The entries as lines, those of other weights below the entry that they took part in.
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
