//! What is said of a completion, by the names of `lsdc complete --json`.

use crate::complete::Completed;
use crate::forms::Forms;
use lsdc_files::{DescribedCloud, DescribedDepth, DescribedFit};
use serde::Serialize;
use std::fmt::Write as _;
use std::time::Duration;

/// A completion in numbers: metres, seconds.
#[derive(Debug, Serialize)]
pub(crate) struct Report {
    points: Points,
    #[serde(skip_serializing_if = "Option::is_none")]
    depth: Option<DescribedDepth>,
    /// How many stored units of the PNG make a metre, if it is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    png_units_per_metre: Option<f64>,
    /// Pixels that hold one unit there, as they are nearer than half of it.
    #[serde(skip_serializing_if = "is_zero")]
    png_raised: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    cloud: Option<DescribedCloud>,
    fit: DescribedFit,
    seconds: Seconds,
    /// What was assumed or left out and should be checked.
    remarks: Vec<String>,
}

#[derive(Debug, Serialize)]
struct Points {
    used: usize,
    /// NaN, infinite or not positive.
    ignored: usize,
    outside: usize,
    hidden: usize,
    unit: String,
    unit_guessed: bool,
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
    judging: f64,
}

#[allow(clippy::trivially_copy_pass_by_ref)]
fn is_zero(count: &usize) -> bool {
    *count == 0
}

impl Report {
    pub(crate) fn new(found: &Completed, forms: &Forms) -> Self {
        let report = found.completion.report();
        let points = &found.points;
        let seconds = |time: Duration| time.as_secs_f64();
        let depth = found.depth.as_ref();
        Self {
            points: Points {
                used: report.used,
                ignored: points.ignored + report.invalid,
                outside: points.outside + report.outside,
                hidden: points.hidden,
                unit: points.unit.to_string(),
                unit_guessed: points.guessed,
            },
            depth: depth.and_then(|depth| DescribedDepth::new(depth, found.clamped)),
            png_units_per_metre: forms.png.map(|png| 1.0 / png.unit.metres()),
            png_raised: forms.png.map_or(0, |png| png.raised),
            cloud: forms.cloud.as_ref().map(DescribedCloud::from),
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
                judging: seconds(found.times.judging),
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
