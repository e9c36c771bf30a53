//! The outcome of an evaluation, as text, JSON and CSV.

mod csv;
mod json;
mod text;

use crate::error::Error;
use crate::metrics::{Scores, Tally};

/// The scores of one frame, one per method.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameScores {
    /// The frame's name.
    pub frame: String,
    /// Sparse points that were given.
    pub points: usize,
    /// In the order of the report's methods.
    pub scores: Vec<Scores>,
}

/// Scores of several methods on the same frames.
#[derive(Debug)]
pub struct Report {
    heading: Heading,
    methods: Vec<String>,
    frames: Vec<FrameScores>,
    failures: Vec<(String, Error)>,
}

/// What was measured, in words: printed above every table and kept in every file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Heading {
    /// The dataset and split.
    pub dataset: String,
    /// Size and cropping.
    pub protocol: String,
    /// The law of the sparse points and its seed.
    pub points: String,
}

impl Report {
    /// An empty report on these methods.
    pub fn new(heading: Heading, methods: Vec<String>) -> Self {
        Self {
            heading,
            methods,
            frames: Vec::new(),
            failures: Vec::new(),
        }
    }

    /// Adds a frame.
    pub fn add(&mut self, frame: FrameScores) {
        self.frames.push(frame);
    }

    /// Notes a frame that could not be measured.
    pub fn fail(&mut self, frame: String, error: Error) {
        self.failures.push((frame, error));
    }

    /// The frames measured, in the order of the dataset.
    pub fn frames(&self) -> &[FrameScores] {
        &self.frames
    }

    /// The frames that could not be measured, and why.
    pub fn failures(&self) -> &[(String, Error)] {
        &self.failures
    }

    /// The first failure, for a report without frames.
    pub fn into_first_failure(self) -> Option<Error> {
        self.failures.into_iter().next().map(|(_, error)| error)
    }

    /// Each method's name and mean scores over all frames.
    pub fn means(&self) -> Vec<(&str, Scores)> {
        self.methods
            .iter()
            .enumerate()
            .map(|(i, method)| {
                let mut tally = Tally::default();
                self.frames.iter().for_each(|f| tally.add(&f.scores[i]));
                (method.as_str(), tally.mean().unwrap_or_default())
            })
            .collect()
    }
}
