//! Timing of a completion, by stages.

use crate::data::Frame;
use crate::predict::complete;
use crate::sampling::Pattern;
use lsdc_core::{Completer, FitError};
use lsdc_files::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::time::{Duration, Instant};

/// Median times of completing a frame, in milliseconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CompletionTimes {
    /// Network: image to features.
    pub network_ms: f64,
    /// Fit: basis functions at the points, and the solve.
    pub fit_ms: f64,
    /// Part of the fit: the field of the image, which later fits to the same image reuse.
    #[serde(default)]
    pub field_ms: f64,
    /// The solve alone.
    pub solve_ms: f64,
    /// Dense depth from the fitted weights.
    pub dense_ms: f64,
    /// Total: image in memory to dense depth in memory.
    pub total_ms: f64,
}

/// Completes a frame `runs` times, after one run to warm up caches and memory.
///
/// # Errors
/// No runs, or a frame that cannot be completed.
pub fn time(
    completer: &Completer,
    frame: &Frame,
    points: &Pattern,
    runs: usize,
) -> Result<CompletionTimes> {
    let sparse = points.draw(frame, 0)?;
    let mut times: Vec<[Duration; 6]> = Vec::with_capacity(runs);
    for run in 0..=runs {
        let started = Instant::now();
        let completion = complete(completer, &frame.rgb, &sparse)?;
        let reading = Instant::now();
        completion.depth()?;
        let (dense, total) = (reading.elapsed(), started.elapsed());
        let report = completion.report();
        if run > 0 {
            let fit = [report.fit, report.field, report.solve];
            times.push([report.network, fit[0], fit[1], fit[2], dense, total]);
        }
    }
    let median = |of: usize| median_ms(times.iter().map(|stages| stages[of]));
    Ok(CompletionTimes {
        network_ms: median(0)?,
        fit_ms: median(1)?,
        field_ms: median(2)?,
        solve_ms: median(3)?,
        dense_ms: median(4)?,
        total_ms: median(5)?,
    })
}

/// Returns the median time, over `runs`, of computing the standard deviation of every pixel after the depth, in milliseconds;
/// `None` if there are too few points.
///
/// # Errors
/// No runs, or a frame that cannot be completed.
pub fn time_deviations(
    completer: &Completer,
    frame: &Frame,
    points: &Pattern,
    runs: usize,
) -> Result<Option<f64>> {
    let sparse = points.draw(frame, 0)?;
    let mut times = Vec::with_capacity(runs);
    for run in 0..=runs {
        let completion = complete(completer, &frame.rgb, &sparse)?;
        completion.depth()?;
        let started = Instant::now();
        let _map = match completion.standard_deviation() {
            Err(lsdc_core::Error::Fit(FitError::TooFewPoints(_))) => return Ok(None),
            found => found?,
        };
        if run > 0 {
            times.push(started.elapsed());
        }
    }
    median_ms(times.into_iter()).map(Some)
}

/// Returns the median in milliseconds.
///
/// # Errors
/// No times.
pub fn median_ms(times: impl Iterator<Item = Duration>) -> Result<f64> {
    let mut values: Vec<f64> = times.map(|t| t.as_secs_f64() * 1e3).collect();
    values.sort_by(f64::total_cmp);
    let middle = values.get(values.len() / 2).copied();
    middle.ok_or_else(|| Error::config("the number of runs must be above 0"))
}
