//! What is said of a completed frame, as text and as JSON.

use super::frame::Completed;
use super::inputs::Loaded;
use super::outputs::Forms;
use crate::cli::ui;
use crate::data::Unit;
use lsdc_files::{DescribedCloud, DescribedDepth, DescribedFit};
use serde::Serialize;
use serde_json::Value;
use std::path::Path;
use std::time::Duration;

/// A frame in numbers: metres, seconds.
#[derive(Debug, Serialize)]
pub(super) struct Summary {
    image: String,
    status: &'static str,
    points: Points,
    depth: Option<DescribedDepth>,
    /// How many stored units of the PNG make a metre, if there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    png_units_per_metre: Option<f64>,
    /// Pixels that hold one unit there, as they are nearer than half of it.
    #[serde(skip_serializing_if = "is_zero")]
    png_raised: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    cloud: Option<DescribedCloud>,
    fit: Option<DescribedFit>,
    seconds: Seconds,
    /// What was assumed or left out and should be checked.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    remarks: Vec<String>,
}

#[derive(Debug, Serialize)]
struct Points {
    used: usize,
    /// NaN, infinite or not positive.
    ignored: usize,
    outside: usize,
    hidden: usize,
    /// Measured when the place of the scanner is not known.
    #[serde(skip_serializing_if = "is_zero")]
    unplaced: usize,
    /// Whether all count at the stamp of their cloud, though those of other frames do not.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    skewed: bool,
    unit: String,
    unit_guessed: bool,
    /// Whether the method looks at the deviations that came with the points; without that they only
    /// weigh points of one pixel, of which it sees the mean.
    #[serde(skip_serializing_if = "Option::is_none")]
    deviations_used: Option<bool>,
}

#[allow(clippy::trivially_copy_pass_by_ref)]
fn is_zero(count: &usize) -> bool {
    *count == 0
}

#[derive(Debug, Serialize)]
struct Seconds {
    reading: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    network: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    fit: Option<f64>,
    /// Part of the fit: the field of the image before any point.
    #[serde(skip_serializing_if = "Option::is_none")]
    field: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    dense: Option<f64>,
}

impl Summary {
    /// Of a frame, its result, and what the formats make of that.
    pub(super) fn new(name: &Path, frame: &Loaded, found: &Completed, forms: &Forms) -> Self {
        let Loaded { points, .. } = frame;
        let fit = found.diagnostics.as_ref();
        let report = fit.map(|fit| fit.completion.report());
        let seconds = |stage: Duration| stage.as_secs_f64();
        let mut remarks = points.remarks.clone();
        let without = report.map_or(0, |report| report.without_deviation);
        if without > 0 {
            remarks.push(format!(
                "{without} points have no standard deviation; they were taken to be exact"
            ));
        }
        Self {
            image: name.display().to_string(),
            status: "completed",
            points: Points {
                used: report.map_or(points.points.len(), |report| report.used),
                ignored: points.ignored + report.map_or(0, |report| report.invalid),
                outside: points.outside + report.map_or(0, |report| report.outside),
                hidden: points.hidden,
                unplaced: frame.unplaced,
                skewed: frame.skewed,
                unit: points.unit.to_string(),
                unit_guessed: points.guessed,
                deviations_used: points
                    .points
                    .iter()
                    .any(|point| point.sigma.is_some())
                    .then_some(fit.is_some()),
            },
            depth: DescribedDepth::new(&found.depth, found.clamped),
            png_units_per_metre: forms.png.map(|png| 1.0 / png.unit.metres()),
            png_raised: forms.png.map_or(0, |png| png.raised),
            cloud: forms.cloud.as_ref().map(DescribedCloud::from),
            fit: fit.map(|fit| {
                DescribedFit::new(
                    &fit.completion,
                    fit.leave_one_out,
                    fit.outliers.as_ref().map(Vec::len),
                    fit.deviations.is_some(),
                )
            }),
            seconds: Seconds {
                reading: seconds(frame.reading),
                network: report.map(|report| seconds(report.network)),
                fit: report.map(|report| seconds(report.fit)),
                field: report.map(|report| seconds(report.field)),
                dense: fit.map(|fit| seconds(fit.dense)),
            },
            remarks,
        }
    }

    /// What was assumed or left out and should be checked.
    pub(super) fn remarks(&self) -> &[String] {
        &self.remarks
    }

    pub(super) fn value(&self) -> Value {
        // Numbers and names always have a form.
        serde_json::to_value(self).unwrap_or_default()
    }

    /// The unit of the 16-bit PNG, if it is not the usual one.
    pub(super) fn unusual_png_unit(&self) -> Option<Unit> {
        let unit = self.png_units_per_metre.and_then(Unit::per_metre);
        unit.filter(|unit| *unit != Unit::MILLIMETRE)
    }

    /// Pixels that hold one unit of the PNG, as they are nearer than half of it.
    pub(super) fn png_raised(&self) -> usize {
        self.png_raised
    }

    /// Pixels that have no point in the cloud: too uncertain ones, those where the lens does not look, flying ones, and those
    /// that share a voxel with others.
    pub(super) fn left_out_of_cloud(&self) -> [usize; 4] {
        self.cloud.as_ref().map_or([0; 4], |cloud| {
            [cloud.uncertain, cloud.unseen, cloud.flying, cloud.merged]
        })
    }

    /// Points that were not fitted: without a usable depth, outside the image, behind others, and without a known place.
    pub(super) fn left_out_of_points(&self) -> [usize; 4] {
        let points = &self.points;
        [
            points.ignored,
            points.outside,
            points.hidden,
            points.unplaced,
        ]
    }

    /// Whether all points count at the stamp of their cloud, though those of other frames do not.
    pub(super) fn is_skewed(&self) -> bool {
        self.points.skewed
    }

    /// Whether a text is the same but for times.
    pub(super) fn is_but_for_times(&self, text: &str) -> bool {
        let parsed = |text: &str| {
            let mut value: Value = serde_json::from_str(text).ok()?;
            value.as_object_mut()?.remove("seconds");
            Some(value)
        };
        parsed(text).is_some_and(|old| Some(old) == parsed(&self.value().to_string()))
    }

    pub(super) fn lines(&self) -> Vec<String> {
        let points = &self.points;
        let mut notes: Vec<String> = left_out_of_points(self.left_out_of_points())
            .into_iter()
            .collect();
        if points.deviations_used == Some(false) {
            notes.push("their deviations only weigh points of one pixel in this method".to_owned());
        }
        let note = if notes.is_empty() {
            String::new()
        } else {
            format!(" ({})", notes.join(", "))
        };
        let guess = if points.unit_guessed {
            " (a guess; --depth-unit says otherwise)"
        } else {
            ""
        };
        let mut lines = vec![
            format!("points    {}{note}", points.used),
            format!("unit      {}{guess}", points.unit),
        ];
        let m = if points.unit == Unit::MODEL.to_string() {
            "units"
        } else {
            "m"
        };
        if let Some(depth) = &self.depth {
            let clamped = match depth.clamped {
                0 => String::new(),
                count => format!(", {count} pixels limited to ten times the range of the points"),
            };
            lines.push(format!(
                "depth     {:.3} to {:.3} {m}, {}x{}{clamped}",
                depth.lowest, depth.highest, depth.width, depth.height
            ));
        }
        if let Some(unit) = self.unusual_png_unit() {
            lines.push(format!(
                "png       {unit} to a value: these depths do not fit in millimetres"
            ));
        }
        lines.extend(raised(self.png_raised));
        if let Some(cloud) = &self.cloud {
            let lost = left_out_of_clouds(self.left_out_of_cloud());
            let lost = lost.map_or(String::new(), |lost| format!(", {lost}"));
            lines.push(format!("cloud     {} points{lost}", cloud.points));
        }
        if let Some(fit) = &self.fit {
            let left_out = fit.leave_one_out.map_or(String::new(), |left_out| {
                format!(", {left_out:.4} {m} at points left out")
            });
            lines.push(format!(
                "residual  {:.4} {m} rms at the points{left_out}, rank {} of {}",
                fit.residual, fit.rank, fit.functions
            ));
            if let Some(trust) = fit.guide_trust {
                lines.push(if trust > 0.0 {
                    format!("guide     used, with weights of about {trust}")
                } else {
                    "guide     not used: the points do not support it".to_owned()
                });
            }
            if let Some(deviations) = fit.deviations_of_95 {
                lines.push(format!(
                    "sigma     68.3 % of errors are expected within 1 standard deviation, 95 % within {deviations:.1}"
                ));
            }
        }
        let stages = [
            ("reading", Some(self.seconds.reading)),
            ("network", self.seconds.network),
            ("fit", self.seconds.fit),
            ("dense", self.seconds.dense),
        ];
        let stages = stages.into_iter().filter_map(|(name, time)| {
            Some(format!(
                "{name} {}",
                ui::millis(Duration::from_secs_f64(time?))
            ))
        });
        lines.push(format!(
            "time      {}",
            stages.collect::<Vec<_>>().join(", ")
        ));
        lines
    }
}

/// That pixels are nearer than half a unit of the PNG, if any are.
pub(super) fn raised(pixels: usize) -> Option<String> {
    (pixels > 0).then(|| format!("png       {pixels} pixels nearer than half a unit hold one"))
}

/// Points that were not fitted, in words.
pub(super) fn left_out_of_points(counts: [usize; 4]) -> Option<String> {
    let reasons = [
        "NaN, infinite or negative values ignored",
        "outside the image",
        "behind others",
        "without a time, or transforms at it",
    ];
    in_words(counts.into_iter().zip(reasons))
}

/// What clouds leave out, if anything: too uncertain pixels, those where the lens does not look, flying ones, and those that
/// share a voxel with others.
pub(super) fn left_out_of_clouds(counts: [usize; 4]) -> Option<String> {
    let reasons = [
        "pixels above --max-sigma left out",
        "pixels left out where the lens does not look",
        "flying pixels left out at depth edges (--keep-flying keeps them)",
        "pixels merged by --voxel",
    ];
    in_words(counts.into_iter().zip(reasons))
}

/// Counts above 0, each with its reason.
fn in_words(counts: impl IntoIterator<Item = (usize, &'static str)>) -> Option<String> {
    let counts = counts.into_iter().filter(|(count, _)| *count > 0);
    let texts: Vec<String> = counts
        .map(|(count, reason)| format!("{count} {reason}"))
        .collect();
    (!texts.is_empty()).then(|| texts.join(", "))
}
