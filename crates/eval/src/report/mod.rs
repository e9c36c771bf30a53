//! The result of an evaluation as text, JSON, CSV, and a page with pictures.

mod bars;
mod basis_functions;
mod chart;
mod colour;
mod colour_map;
mod csv;
mod curve;
mod drawing;
mod html;
mod json;
mod panels;
mod ranges;
mod scenes;
mod section;
mod table;
mod text;
mod training;

pub use bars::Bars;
pub use basis_functions::{contact_sheet, diverging_scale, kernels};
pub use chart::{AxisScales, Chart, Line};
pub use colour::{coloured, diverging};
pub use colour_map::{colour_map, usual_range};
pub use curve::Curve;
pub use drawing::Drawing;
pub use html::ExampleFrame;
pub use panels::{ColourScale, Panel, Panels};
pub use section::{Figure, Section, write_page};
pub use table::{Column, Ranking, Row, Table};
pub use training::Training;

use crate::data::{Environment, Shard};
use crate::metrics::{
    DepthRangeErrors, ErrorProfile, Metric, PairedDifference, Rules, ScoreAccumulator, Scores,
    UncertaintyScores, mean_and_deviation,
};
use lsdc_files::error::{Error, Result};
use lsdc_weights::provenance::{FileStamp, differences};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Settings of an evaluation, as text and numbers: printed above every table and stored in every file. Only reports with the
/// same heading can be joined.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Heading {
    /// Dataset and split.
    pub dataset: String,
    /// Description of the dataset as found on disk.
    pub found: String,
    /// Name and source of the protocol.
    pub protocol: String,
    /// Steps of the protocol.
    pub steps: String,
    /// Pattern of the sparse points.
    pub points: String,
    /// Pixels held out of the frames, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hold_out: Option<String>,
    /// Noise added to the points, if any.
    pub noise: Option<String>,
    /// Seeds of the draws of points.
    pub seeds: Vec<u64>,
    /// Names of the methods, in order.
    pub methods: Vec<String>,
    /// Weights of the network.
    pub weights: Option<String>,
    /// Limits of the predictions.
    pub limits: String,
    /// Parameters of the metrics.
    pub rules: Rules,
    /// Largest standard deviation, as a fraction of the predicted depth, that counts as certain, if they were measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma_cut: Option<f64>,
    /// Number of frames of the whole evaluation, including those of other shards.
    pub frames: usize,
    /// Record of everything that the numbers depend on, including what the fields above mention: the program, the settings,
    /// files by their contents.
    pub made_from: serde_json::Value,
}

impl Heading {
    /// Returns the first value that differs from another heading, if there is one.
    fn difference(&self, other: &Self) -> Option<String> {
        let value = |heading: &Self| serde_json::to_value(heading).unwrap_or_default();
        let found = differences(&value(self), &value(other));
        found.into_iter().next()
    }
}

/// Result of a method for a frame and a draw of points.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MethodOutcome {
    /// Values of the metrics.
    pub scores: Scores,
    /// Error profile.
    pub profile: ErrorProfile,
    /// Scores of the predicted standard deviations, if they were predicted.
    #[serde(rename = "certainty", default, skip_serializing_if = "Option::is_none")]
    pub uncertainty: Option<UncertaintyScores>,
    /// Errors by true depth.
    pub ranges: DepthRangeErrors,
}

/// A frame with one draw of points.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrameRecord {
    /// The frame's name.
    pub frame: String,
    /// Seed of the draw.
    pub seed: u64,
    /// Number of sparse points given.
    pub points: usize,
    /// Whether the frame was taken indoors or outdoors.
    pub place: Environment,
    /// Scene of the frame, if the dataset defines it other than by the folders in names.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scene: Option<String>,
    /// Results of the methods, in the order of the heading.
    pub outcomes: Vec<MethodOutcome>,
    /// Stamps of the files of the frame when it was measured, in the order of the dataset.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub files: Vec<FileStamp>,
}

/// A frame that could not be measured.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Failure {
    /// The frame's name.
    pub frame: String,
    /// Message of the error.
    pub error: String,
}

/// Scores of a frame under one seed: the part of a [`FrameRecord`] kept in a report.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameScores {
    /// Number of sparse points given.
    pub points: usize,
    /// Whether the frame was taken indoors or outdoors.
    pub place: Environment,
    /// Scene of the frame, if the dataset defines it other than by the folders in names.
    pub scene: Option<String>,
    /// Scores of the methods, in the order of the heading.
    pub scores: Vec<Scores>,
}

/// Scores of several methods on the same frames.
#[derive(Clone, Debug, PartialEq)]
pub struct EvaluationReport {
    heading: Heading,
    /// Scores by frame and seed. Every sum runs in this order, independent of the order of measuring.
    frames: BTreeMap<(String, u64), FrameScores>,
    /// Sums of the methods, in the order of the heading.
    sums: Vec<Sums>,
    failures: Vec<Failure>,
    /// Shards of the frames in this report.
    parts: Vec<Shard>,
}

/// Errors of one method over all frames.
#[derive(Clone, Debug, Default, PartialEq)]
struct Sums {
    profile: ErrorProfile,
    uncertainty: Option<UncertaintyScores>,
    ranges: DepthRangeErrors,
}

impl Sums {
    fn add(
        &mut self,
        profile: &ErrorProfile,
        uncertainty: Option<&UncertaintyScores>,
        ranges: &DepthRangeErrors,
    ) {
        self.profile.add(profile);
        if let Some(uncertainty) = uncertainty {
            self.uncertainty.get_or_insert_default().add(uncertainty);
        }
        self.ranges.add(ranges);
    }
}

/// A method's average over all frames.
#[derive(Clone, Debug, PartialEq)]
pub struct Mean<'a> {
    /// Name of the method.
    pub method: &'a str,
    /// Mean over seeds of the mean over frames.
    pub mean: Scores,
    /// Standard deviation over seeds; NaN for a single seed.
    pub deviation: Scores,
}

impl EvaluationReport {
    /// Creates an empty report.
    pub fn new(heading: Heading) -> Self {
        Self {
            sums: vec![Sums::default(); heading.methods.len()],
            heading,
            frames: BTreeMap::new(),
            failures: Vec::new(),
            parts: vec![Shard::WHOLE],
        }
    }

    /// Sets the shard of the frames in this report.
    #[must_use]
    pub fn of_part(mut self, part: Shard) -> Self {
        self.parts = vec![part];
        self
    }

    /// Checks that no frame is missing. Reports joined into a whole count as one.
    ///
    /// # Errors
    /// A shard is missing, which is named, or frames of an interrupted one.
    pub fn complete(mut self) -> Result<Self> {
        let missing: Vec<String> = Shard::missing(&self.parts)?
            .iter()
            .map(|part| format!("{part}"))
            .collect();
        if !missing.is_empty() {
            return Err(
                Error::config(format!("parts are missing: {}", missing.join(", ")))
                    .hint("give the reports of all parts of --shard"),
            );
        }
        let found = self.count() + self.failures.len();
        if found < self.heading.frames {
            return Err(Error::config(format!(
                "{} of {} frames are missing",
                self.heading.frames - found,
                self.heading.frames
            ))
            .hint("let every part go on to its end: the same command does"));
        }
        self.parts = vec![Shard::WHOLE];
        Ok(self)
    }

    /// Returns the heading.
    pub fn heading(&self) -> &Heading {
        &self.heading
    }

    /// Adds a frame with one draw of points.
    ///
    /// # Errors
    /// The frame exists already, or has results of other methods.
    pub fn add(&mut self, record: FrameRecord) -> Result<()> {
        if record.outcomes.len() != self.heading.methods.len() {
            return Err(Error::config(format!(
                "frame `{}` has outcomes of {} methods, expected {}",
                record.frame,
                record.outcomes.len(),
                self.heading.methods.len()
            )));
        }
        for (sums, outcome) in self.sums.iter_mut().zip(&record.outcomes) {
            sums.add(
                &outcome.profile,
                outcome.uncertainty.as_ref(),
                &outcome.ranges,
            );
        }
        let scores = FrameScores {
            points: record.points,
            place: record.place,
            scene: record.scene,
            scores: record.outcomes.iter().map(|o| o.scores).collect(),
        };
        self.insert((record.frame, record.seed), scores)
    }

    /// Records a frame that could not be measured.
    pub fn fail(&mut self, failure: Failure) {
        self.failures.push(failure);
        self.failures.sort_by(|a, b| a.frame.cmp(&b.frame));
    }

    /// Joins a report on other frames. The result is identical, to the last bit, to measuring all frames at once.
    ///
    /// # Errors
    /// The headings differ, or both reports have a frame in common.
    pub fn join(&mut self, other: Self) -> Result<()> {
        if let Some(difference) = self.heading.difference(&other.heading) {
            return Err(Error::config(format!(
                "the reports do not measure the same thing: {difference}"
            ))
            .hint("dataset, protocol, points, seeds, methods, fit and weights must be equal"));
        }
        for (key, scores) in other.frames {
            self.insert(key, scores)?;
        }
        for (sums, more) in self.sums.iter_mut().zip(&other.sums) {
            sums.add(&more.profile, more.uncertainty.as_ref(), &more.ranges);
        }
        other.failures.into_iter().for_each(|f| self.fail(f));
        self.parts.extend(other.parts);
        self.parts.sort_unstable();
        Ok(())
    }

    fn insert(&mut self, key: (String, u64), scores: FrameScores) -> Result<()> {
        if self.frames.contains_key(&key) {
            return Err(Error::config(format!(
                "frame `{}` with seed {} is there twice",
                key.0, key.1
            ))
            .hint("join each shard once"));
        }
        self.frames.insert(key, scores);
        Ok(())
    }

    /// Returns the measured frames, by name and seed.
    pub fn frames(&self) -> &BTreeMap<(String, u64), FrameScores> {
        &self.frames
    }

    /// Returns the frames that could not be measured, with their errors.
    pub fn failures(&self) -> &[Failure] {
        &self.failures
    }

    /// Returns the uncertainty scores of a method, by its index in the heading, if it predicted standard deviations.
    pub fn uncertainty(&self, method: usize) -> Option<&UncertaintyScores> {
        self.sums.get(method)?.uncertainty.as_ref()
    }

    /// Returns the number of measured frames, each counted once.
    pub fn count(&self) -> usize {
        let names: BTreeSet<&str> = self
            .frames
            .keys()
            .map(|(frame, _)| frame.as_str())
            .collect();
        names.len()
    }

    /// Returns the environments that occur among the frames.
    pub fn places(&self) -> Vec<Environment> {
        [Environment::Indoor, Environment::Outdoor]
            .into_iter()
            .filter(|place| self.frames.values().any(|f| f.place == *place))
            .collect()
    }

    /// Returns each method's average, over all frames or those of one environment.
    pub fn means(&self, place: Option<Environment>) -> Vec<Mean<'_>> {
        self.means_where(|_, frame| place.is_none_or(|place| place == frame.place))
    }

    /// Returns each method's average over the frames for which `counts`, given name and scores, is true.
    fn means_where(&self, counts: impl Fn(&str, &FrameScores) -> bool) -> Vec<Mean<'_>> {
        let of = |method: usize| -> Vec<Scores> {
            let mut by_seed = BTreeMap::<u64, ScoreAccumulator>::new();
            for ((name, seed), frame) in &self.frames {
                if counts(name, frame) {
                    by_seed.entry(*seed).or_default().add(&frame.scores[method]);
                }
            }
            by_seed
                .values()
                .filter_map(ScoreAccumulator::mean)
                .collect()
        };
        let methods = self.heading.methods.iter().enumerate();
        methods
            .map(|(i, method)| {
                let (mean, deviation) = mean_and_deviation(&of(i));
                Mean {
                    method,
                    mean,
                    deviation,
                }
            })
            .collect()
    }

    /// Returns the scores of a method on each frame, averaged over seeds.
    fn by_frame(&self, method: usize) -> BTreeMap<&str, Scores> {
        let mut accumulators = BTreeMap::<&str, ScoreAccumulator>::new();
        for ((frame, _), scores) in &self.frames {
            accumulators
                .entry(frame)
                .or_default()
                .add(&scores.scores[method]);
        }
        let mean = |accumulator: &ScoreAccumulator| accumulator.mean().unwrap_or_default();
        accumulators
            .iter()
            .map(|(frame, accumulator)| (*frame, mean(accumulator)))
            .collect()
    }

    /// Compares every later method with the first: second minus first, paired by frame, each frame averaged over seeds. `None`
    /// with fewer than two frames.
    pub fn differences(&self, metric: Metric) -> Vec<(&str, Option<PairedDifference>)> {
        if self.heading.methods.is_empty() {
            return Vec::new();
        }
        let first = self.by_frame(0);
        let others = self.heading.methods.iter().enumerate().skip(1);
        others
            .map(|(i, method)| {
                let second = self.by_frame(i);
                let pairs = first
                    .iter()
                    .map(|(frame, a)| (a[metric], second[frame][metric]));
                (method.as_str(), PairedDifference::of(pairs))
            })
            .collect()
    }

    /// Returns the frames with the smallest, median and largest RMSE of the first method under the first seed, with their
    /// roles.
    pub fn example_frames(&self) -> Vec<(&'static str, &str, u64)> {
        let Some(&seed) = self.heading.seeds.first() else {
            return Vec::new();
        };
        let mut order: Vec<(&str, f64)> = self
            .frames
            .iter()
            .filter(|((_, s), _)| *s == seed)
            .filter_map(|((frame, _), f)| Some((frame.as_str(), f.scores.first()?[Metric::Rmse])))
            .collect();
        order.sort_by(|a, b| a.1.total_cmp(&b.1));
        let pick = |name, i: usize| order.get(i).map(|(frame, _)| (name, *frame, seed));
        let last = order.len().saturating_sub(1);
        let mut picks: Vec<_> = [
            pick("worst", last),
            pick("median", last / 2),
            pick("best", 0),
        ]
        .into_iter()
        .flatten()
        .collect();
        picks.dedup_by_key(|(_, frame, _)| *frame);
        picks
    }
}

#[cfg(test)]
mod tests;
