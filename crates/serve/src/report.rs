//! The report of a completion, with the names of `lsdc complete --json`.

use crate::complete::CompletionResult;
use lsdc_files::{DescribedCloud, DescribedDepth, DescribedFit, DescribedPng, DescribedPoints};
use serde::Serialize;
use std::fmt::Write as _;
use std::time::Duration;

/// A completion in numbers: metres, seconds.
#[derive(Debug, Serialize)]
pub(crate) struct JsonReport {
    points: DescribedPoints,
    #[serde(skip_serializing_if = "Option::is_none")]
    depth: Option<DescribedDepth>,
    /// The PNG, if the answer is one.
    #[serde(flatten)]
    pub(crate) png: Option<DescribedPng>,
    /// The cloud, if the answer is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) cloud: Option<DescribedCloud>,
    fit: DescribedFit,
    seconds: Seconds,
    /// Warnings: assumptions to check, and what was left out.
    remarks: Vec<String>,
}

#[derive(Debug, Serialize)]
struct Seconds {
    reading: f64,
    network: f64,
    fit: f64,
    /// Part of the fit: the field of the image before any point.
    field: f64,
    dense: f64,
    deviation: f64,
    /// The leave-one-out errors and the outlier test.
    judging: f64,
}

impl JsonReport {
    pub(crate) fn new(found: &CompletionResult) -> Self {
        let report = found.completion.report();
        let seconds = |time: Duration| time.as_secs_f64();
        let depth = found.depth.as_ref();
        Self {
            points: DescribedPoints::new(&found.points, Some(&found.completion)),
            depth: depth.and_then(|depth| DescribedDepth::new(depth, found.clamped)),
            png: None,
            cloud: None,
            fit: DescribedFit::new(
                &found.completion,
                found.leave_one_out,
                found.outliers.as_deref(),
                found.deviations.is_some(),
            ),
            seconds: Seconds {
                reading: seconds(found.times.reading),
                network: seconds(report.network),
                fit: seconds(report.fit),
                field: seconds(report.field),
                dense: seconds(found.times.dense),
                deviation: seconds(found.times.deviation),
                judging: seconds(found.times.outlier_test),
            },
            remarks: found.remarks(),
        }
    }

    /// On one line.
    pub(crate) fn line(&self) -> String {
        // Numbers and names always have a form; as a value, single precision is written out as double.
        serde_json::to_value(self).unwrap_or_default().to_string()
    }

    /// On one line of the characters that a header may have.
    pub(crate) fn header(&self) -> String {
        let mut text = String::new();
        for c in self.line().chars() {
            if c.is_ascii() {
                text.push(c);
            } else {
                for unit in c.encode_utf16(&mut [0; 2]) {
                    // Writing to a string does not fail.
                    let _ = write!(text, "\\u{unit:04x}");
                }
            }
        }
        text
    }
}
