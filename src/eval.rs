//! Measuring methods on a dataset: the same frames and the same points for each.

use crate::data::Dataset;
use crate::error::{Error, Result};
use crate::metrics::Scores;
use crate::predict::{Completer, Method, RANGE, complete_linear};
use crate::report::{FrameScores, Heading, Report};
use crate::sample::{Pattern, Protocol};
use serde::{Deserialize, Serialize};
use std::ops::ControlFlow;

/// What is measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EvalConfig {
    /// Sparse points per frame.
    pub points: usize,
    /// Names the masks; every method gets the same.
    pub seed: u64,
    /// Methods side by side.
    pub methods: Vec<Method>,
    /// Measure only the first frames.
    pub limit: Option<usize>,
    /// The size at which to measure; the dataset's own protocol if absent.
    pub protocol: Option<Protocol>,
}

impl Default for EvalConfig {
    fn default() -> Self {
        Self {
            points: 500,
            seed: 0,
            methods: vec![Method::Lsdc, Method::Linear],
            limit: None,
            protocol: None,
        }
    }
}

impl EvalConfig {
    /// Checks every setting.
    ///
    /// # Errors
    /// The first setting that is out of range.
    pub fn check(&self) -> Result<()> {
        if self.points == 0 || self.methods.is_empty() || self.limit == Some(0) {
            return Err(Error::config(
                "`eval.points` and `limit` must be above 0, and `methods` must name one",
            ));
        }
        Ok(())
    }
}

/// Measures every method on every frame, calling `progress` with the number of frames done and of
/// all; it may break off, and the report then holds the frames so far.
///
/// A frame that cannot be read or completed is listed in the report and left out of the means.
///
/// # Errors
/// Not a single frame could be measured.
pub fn evaluate(
    frames: &dyn Dataset,
    dataset: &str,
    protocol: &Protocol,
    config: &EvalConfig,
    completer: &Completer,
    mut progress: impl FnMut(usize, usize) -> ControlFlow<()>,
) -> Result<Report> {
    let total = frames.len().min(config.limit.unwrap_or(usize::MAX));
    let heading = Heading {
        dataset: dataset.to_owned(),
        protocol: protocol.to_string(),
        points: format!(
            "{}, seed {}; predictions limited to {RANGE} x the range of the points",
            Pattern::Exactly(config.points),
            config.seed
        ),
    };
    let methods = config.methods.iter().map(|m| m.name().to_owned()).collect();
    let mut report = Report::new(heading, methods);
    for index in 0..total {
        match measure(frames, index, protocol, config, completer) {
            Ok(scores) => report.add(scores),
            Err(error) => report.fail(frames.id(index), error),
        }
        if progress(index + 1, total).is_break() {
            break;
        }
    }
    if report.frames().is_empty() {
        return Err(report
            .into_first_failure()
            .unwrap_or_else(|| Error::config("the dataset has no frame")));
    }
    Ok(report)
}

fn measure(
    frames: &dyn Dataset,
    index: usize,
    protocol: &Protocol,
    config: &EvalConfig,
    completer: &Completer,
) -> Result<FrameScores> {
    let frame = protocol.apply(&frames.load(index)?)?;
    let sparse = Pattern::Exactly(config.points).draw(&frame.depth, config.seed, &frame.id);
    let scores = config
        .methods
        .iter()
        .map(|method| {
            let depth = match method {
                Method::Lsdc => completer.complete(&frame.rgb, &sparse, None)?.depth,
                Method::Linear => complete_linear(&frame.rgb, &sparse)?,
            };
            Scores::of(&depth, &frame.depth)
        })
        .collect::<Result<_>>()?;
    Ok(FrameScores {
        frame: frame.id,
        points: sparse.count(),
        scores,
    })
}
