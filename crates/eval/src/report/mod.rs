//! The outcome of an evaluation: text, JSON, CSV and a page with pictures.

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

/// What was measured, in words and numbers: printed above every table and kept in every file. Two
/// reports with the same heading may be joined.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Heading {
    /// The dataset and split.
    pub dataset: String,
    /// What was found where the dataset lies.
    pub found: String,
    /// The protocol's name and source.
    pub protocol: String,
    /// Its steps.
    pub steps: String,
    /// The law of the sparse points.
    pub points: String,
    /// What was held out of the frames, if anything was.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hold_out: Option<String>,
    /// What was done to them.
    pub noise: Option<String>,
    /// The seeds of the points.
    pub seeds: Vec<u64>,
    /// What is compared, in order.
    pub methods: Vec<String>,
    /// The weights of the network.
    pub weights: Option<String>,
    /// Limits of the predictions.
    pub limits: String,
    /// What the measures leave open.
    pub rules: Rules,
    /// The share of the predicted depth up to which a standard deviation counts as certain, if they were measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma_cut: Option<f64>,
    /// Frames in all, whichever shard measured them.
    pub frames: usize,
    /// Everything that the numbers depend on, whether the words above mention it or not: the program,
    /// the settings, files by their contents.
    pub made_from: serde_json::Value,
}

impl Heading {
    /// The first value that another heading has otherwise, if there is one.
    fn difference(&self, other: &Self) -> Option<String> {
        let value = |heading: &Self| serde_json::to_value(heading).unwrap_or_default();
        let found = differences(&value(self), &value(other));
        found.into_iter().next()
    }
}

/// How one method did on one frame with one draw of points.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MethodOutcome {
    /// The measures.
    pub scores: Scores,
    /// Where the errors are.
    pub profile: ErrorProfile,
    /// How well they were predicted, if they were.
    #[serde(rename = "certainty", default, skip_serializing_if = "Option::is_none")]
    pub uncertainty: Option<UncertaintyScores>,
    /// The errors by true depth.
    pub ranges: DepthRangeErrors,
}

/// One frame with one draw of points.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrameRecord {
    /// The frame's name.
    pub frame: String,
    /// Names the draw.
    pub seed: u64,
    /// Sparse points that were given.
    pub points: usize,
    /// Where the frame was taken.
    pub place: Environment,
    /// The scene that it shows, if the dataset knows it by other means than the folders in names.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scene: Option<String>,
    /// One for each method, in the order of the heading.
    pub outcomes: Vec<MethodOutcome>,
    /// The files of the frame as they were when it was measured, in the order of the dataset.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub files: Vec<FileStamp>,
}

/// A frame that could not be measured.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Failure {
    /// The frame's name.
    pub frame: String,
    /// What was wrong.
    pub error: String,
}

/// Scores of a frame under one seed: what a report keeps of a [`FrameRecord`].
#[derive(Clone, Debug, PartialEq)]
pub struct FrameScores {
    /// Sparse points that were given.
    pub points: usize,
    /// Where the frame was taken.
    pub place: Environment,
    /// The scene that it shows, if the dataset knows it by other means than the folders in names.
    pub scene: Option<String>,
    /// One for each method, in the order of the heading.
    pub scores: Vec<Scores>,
}

/// Scores of several methods on the same frames.
#[derive(Clone, Debug, PartialEq)]
pub struct EvaluationReport {
    heading: Heading,
    /// By frame and seed; every sum runs in this order, whatever the order of measuring.
    frames: BTreeMap<(String, u64), FrameScores>,
    /// One for each method, in the order of the heading.
    sums: Vec<Sums>,
    failures: Vec<Failure>,
    /// Which parts of the frames these are.
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
    /// Its name.
    pub method: &'a str,
    /// The mean over seeds of the mean over frames.
    pub mean: Scores,
    /// Its standard deviation over seeds; NaN for a single seed.
    pub deviation: Scores,
}

impl EvaluationReport {
    /// An empty report.
    pub fn new(heading: Heading) -> Self {
        Self {
            sums: vec![Sums::default(); heading.methods.len()],
            heading,
            frames: BTreeMap::new(),
            failures: Vec::new(),
            parts: vec![Shard::WHOLE],
        }
    }

    /// A report of the frames of one part.
    #[must_use]
    pub fn of_part(mut self, part: Shard) -> Self {
        self.parts = vec![part];
        self
    }

    /// Checks that no frame is missing. Reports that are joined to the whole count as one.
    ///
    /// # Errors
    /// A part is missing, which is named, or frames of one that broke off.
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

    /// What was measured.
    pub fn heading(&self) -> &Heading {
        &self.heading
    }

    /// Adds a frame with one draw of points.
    ///
    /// # Errors
    /// It is there already, or has outcomes of other methods.
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

    /// Notes a frame that could not be measured.
    pub fn fail(&mut self, failure: Failure) {
        self.failures.push(failure);
        self.failures.sort_by(|a, b| a.frame.cmp(&b.frame));
    }

    /// Joins a report on other frames. The result is the same, to the last bit, as if all frames
    /// had been measured at once.
    ///
    /// # Errors
    /// Another heading, or a frame that both have.
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

    /// The frames measured, by name and seed.
    pub fn frames(&self) -> &BTreeMap<(String, u64), FrameScores> {
        &self.frames
    }

    /// The frames that could not be measured, and why.
    pub fn failures(&self) -> &[Failure] {
        &self.failures
    }

    /// How well a method, by its place in the heading, predicted its errors, if it did.
    pub fn uncertainty(&self, method: usize) -> Option<&UncertaintyScores> {
        self.sums.get(method)?.uncertainty.as_ref()
    }

    /// The number of frames measured, each counted once.
    pub fn count(&self) -> usize {
        let names: BTreeSet<&str> = self
            .frames
            .keys()
            .map(|(frame, _)| frame.as_str())
            .collect();
        names.len()
    }

    /// The places of the frames.
    pub fn places(&self) -> Vec<Environment> {
        [Environment::Indoor, Environment::Outdoor]
            .into_iter()
            .filter(|place| self.frames.values().any(|f| f.place == *place))
            .collect()
    }

    /// Each method's average, over all frames or those of one place.
    pub fn means(&self, place: Option<Environment>) -> Vec<Mean<'_>> {
        self.means_where(|_, frame| place.is_none_or(|place| place == frame.place))
    }

    /// Each method's average over the frames that count, by their names and scores.
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

    /// The scores of a method on each frame, averaged over seeds.
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

    /// Every later method against the first: second minus first, paired by frame, each frame
    /// averaged over seeds. `None` with fewer than two frames.
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

    /// The frames in which the first method has its smallest, median and largest RMSE, by the
    /// first seed: the best, an ordinary and the worst.
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
