//! The machine-readable report: everything, without rounding.

use super::Report;
use crate::data::write_atomically;
use crate::error::Result;
use serde_json::{Map, Value, json};
use std::path::Path;

impl Report {
    /// The report as one JSON object.
    pub fn to_json(&self) -> Value {
        let by_method = |scores: &mut dyn Iterator<Item = Value>| -> Value {
            let names = self.methods.iter().cloned();
            Value::Object(names.zip(scores).collect::<Map<_, _>>())
        };
        let frames: Vec<Value> = self
            .frames
            .iter()
            .map(|frame| {
                json!({
                    "frame": frame.frame,
                    "points": frame.points,
                    "scores": by_method(&mut frame.scores.iter().map(|s| json!(s))),
                })
            })
            .collect();
        let failures: Vec<Value> = self
            .failures
            .iter()
            .map(|(frame, error)| json!({ "frame": frame, "error": error.to_string() }))
            .collect();
        json!({
            "lsdc": env!("CARGO_PKG_VERSION"),
            "dataset": self.heading.dataset,
            "protocol": self.heading.protocol,
            "points": self.heading.points,
            "units": "rmse and mae in metres; rel and delta as fractions",
            "means": by_method(&mut self.means().into_iter().map(|(_, s)| json!(s))),
            "frames": frames,
            "failures": failures,
        })
    }

    /// Writes the JSON object to a file.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write_json(&self, path: &Path) -> Result<()> {
        let value = self.to_json();
        write_atomically(path, |out| {
            serde_json::to_writer_pretty(&mut *out, &value)?;
            writeln!(out)
        })
    }
}
