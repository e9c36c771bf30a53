//! The machine-readable report, without rounding.

use super::{EvaluationReport, Failure, FrameScores, Heading, Mean, Sums};
use crate::data::{Environment, Shard, write_atomically};
use crate::metrics::{DepthRangeErrors, ErrorProfile, Metric, Scores, UncertaintyScores};
use lsdc_files::error::{Error, Result};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::path::Path;

/// The fields that a report is read back from; all other fields are derived.
#[derive(Deserialize)]
struct File {
    heading: Heading,
    profiles: BTreeMap<String, ErrorProfile>,
    #[serde(rename = "certainties")]
    uncertainties: BTreeMap<String, UncertaintyScores>,
    ranges: BTreeMap<String, DepthRangeErrors>,
    frames: Vec<Line>,
    failures: Vec<Failure>,
    parts: Vec<Shard>,
}

#[derive(Serialize, Deserialize)]
struct Line {
    frame: String,
    seed: u64,
    points: usize,
    place: Environment,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    scene: Option<String>,
    scores: BTreeMap<String, Scores>,
}

impl EvaluationReport {
    /// Returns the report as one JSON object.
    pub fn to_json(&self) -> Value {
        let methods = || self.heading.methods.iter().cloned();
        let frames: Vec<Line> = self
            .frames
            .iter()
            .map(|((frame, seed), scores)| Line {
                frame: frame.clone(),
                seed: *seed,
                points: scores.points,
                place: scores.place,
                scene: scores.scene.clone(),
                scores: methods().zip(scores.scores.iter().copied()).collect(),
            })
            .collect();
        let sums = || methods().zip(&self.sums);
        let profiles: BTreeMap<String, &ErrorProfile> = sums()
            .map(|(method, sums)| (method, &sums.profile))
            .collect();
        let uncertainties: BTreeMap<String, &UncertaintyScores> = sums()
            .filter_map(|(method, sums)| Some((method, sums.uncertainty.as_ref()?)))
            .collect();
        let ranges: BTreeMap<String, &DepthRangeErrors> = sums()
            .map(|(method, sums)| (method, &sums.ranges))
            .collect();
        let scenes: Map<String, Value> = self
            .scenes()
            .into_keys()
            .map(|scene| (scene.to_owned(), averages(&self.means_of_scene(scene))))
            .collect();
        let units: Map<String, Value> = Metric::ALL
            .iter()
            .map(|m| {
                (
                    m.key().to_owned(),
                    json!(if m.is_share() { "fraction" } else { m.unit() }),
                )
            })
            .collect();
        let places: Map<String, Value> = self
            .places()
            .into_iter()
            .map(|place| {
                (
                    json!(place).as_str().unwrap_or_default().to_owned(),
                    averages(&self.means(Some(place))),
                )
            })
            .collect();
        json!({
            "lsdc": env!("CARGO_PKG_VERSION"),
            "heading": self.heading,
            "averaged": self.heading.rules.to_string(),
            "units": units,
            "means": averages(&self.means(None)),
            "places": places,
            "scenes": scenes,
            "by_depth": self.by_depth(),
            "differences": self.all_differences(),
            "profiles": profiles,
            "certainties": uncertainties,
            "ranges": ranges,
            "frames": frames,
            "failures": self.failures,
            "parts": self.parts,
        })
    }

    /// Reads a report back.
    ///
    /// # Errors
    /// Text that is not a report, or one that contradicts itself.
    pub fn from_json(text: &str) -> Result<Self> {
        let file: File = serde_json::from_str(text)
            .map_err(|e| Error::config("this is no report of `lsdc eval --json`").because(e))?;
        let missing = |method: &String| Error::config(format!("no scores of `{method}`"));
        let mut report = Self::new(file.heading);
        for (sums, method) in report.sums.iter_mut().zip(&report.heading.methods) {
            *sums = Sums {
                profile: file.profiles.get(method).cloned().unwrap_or_default(),
                uncertainty: file.uncertainties.get(method).cloned(),
                ranges: file.ranges.get(method).cloned().unwrap_or_default(),
            };
        }
        for line in file.frames {
            let methods = report.heading.methods.iter();
            let scores = methods
                .map(|m| line.scores.get(m).copied().ok_or_else(|| missing(m)))
                .collect::<Result<_>>()?;
            let scores = FrameScores {
                points: line.points,
                place: line.place,
                scene: line.scene,
                scores,
            };
            report.insert((line.frame, line.seed), scores)?;
        }
        file.failures.into_iter().for_each(|f| report.fail(f));
        report.parts = file.parts;
        Ok(report)
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

    /// Reads a file written by [`write_json`](Self::write_json).
    ///
    /// # Errors
    /// The file cannot be read, or is not a report.
    pub fn read_json(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::read(path, e))?;
        Self::from_json(&text).map_err(|e| Error::format(path, "is not a report").because(e))
    }

    /// Returns the differences, second minus first, by method and metric.
    fn all_differences(&self) -> Value {
        let mut by_method = BTreeMap::<&str, Map<String, Value>>::new();
        for metric in Metric::ALL {
            for (method, difference) in self.differences(metric) {
                let values = by_method.entry(method).or_default();
                values.insert(metric.key().to_owned(), json!(difference));
            }
        }
        json!({ "from": self.heading.methods.first(), "to": by_method })
    }
}

fn averages(means: &[Mean]) -> Value {
    let value = |m: &Mean| json!({ "mean": m.mean, "deviation": m.deviation });
    let by_method: Map<String, Value> = means
        .iter()
        .map(|m| (m.method.to_owned(), value(m)))
        .collect();
    Value::Object(by_method)
}
