//! What is said of a completed frame, as text and as JSON.

use super::frame::Completed;
use super::inputs::Loaded;
use crate::cli::ui;
use crate::data::Unit;
use crate::fit::root_mean_square;
use serde::Serialize;
use std::path::Path;
use std::time::Duration;

/// A frame in numbers: metres, seconds.
#[derive(Debug, Serialize)]
pub(super) struct Summary {
    image: String,
    points: Points,
    depth: Option<Depth>,
    fit: Option<Fit>,
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
    unit: String,
    unit_guessed: bool,
    /// Whether the method looks at the deviations that came with the points.
    #[serde(skip_serializing_if = "Option::is_none")]
    deviations_used: Option<bool>,
}

#[derive(Debug, Serialize)]
struct Depth {
    width: usize,
    height: usize,
    lowest: f32,
    highest: f32,
}

#[derive(Debug, Serialize)]
struct Fit {
    method: &'static str,
    /// Root mean square at the points.
    residual: f64,
    /// Root mean square at each point as the others say (PRESS).
    #[serde(skip_serializing_if = "Option::is_none")]
    left_out: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    outliers: Option<usize>,
    rank: usize,
    /// Base functions, of which that many directions at most are determined.
    functions: usize,
}

#[derive(Debug, Serialize)]
struct Seconds {
    reading: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    network: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    fit: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    dense: Option<f64>,
}

impl Summary {
    pub(super) fn new(name: &Path, frame: &Loaded, found: &Completed) -> Self {
        let Loaded { points, .. } = frame;
        let fitted = found.fitted.as_ref();
        let seconds = |stage: Duration| stage.as_secs_f64();
        Self {
            image: name.display().to_string(),
            points: Points {
                used: points.points.len(),
                ignored: points.ignored,
                outside: points.outside,
                hidden: points.hidden,
                unit: points.unit.to_string(),
                unit_guessed: points.guessed,
                deviations_used: points
                    .points
                    .iter()
                    .any(|point| point.sigma.is_some())
                    .then_some(fitted.is_some()),
            },
            depth: found.depth.range().map(|(lowest, highest)| Depth {
                width: found.depth.width(),
                height: found.depth.height(),
                lowest,
                highest,
            }),
            fit: fitted.map(|fitted| Fit {
                method: fitted.method.name(),
                residual: fitted.fit.rms(),
                left_out: fitted.left_out().map(|left| root_mean_square(&left)),
                outliers: fitted.outlying().map(|points| points.len()),
                rank: fitted.fit.rank,
                functions: fitted.fit.functions(),
            }),
            seconds: Seconds {
                reading: seconds(frame.reading),
                network: fitted.map(|fitted| seconds(fitted.network)),
                fit: fitted.map(|fitted| seconds(fitted.fitting)),
                dense: fitted.map(|fitted| seconds(fitted.dense)),
            },
            remarks: points.remarks.clone(),
        }
    }

    /// What was assumed or left out and should be checked.
    pub(super) fn remarks(&self) -> &[String] {
        &self.remarks
    }

    pub(super) fn json(&self) -> String {
        // Numbers and names always have a form.
        serde_json::to_string(self).unwrap_or_default()
    }

    /// Whether a text is the same but for times.
    pub(super) fn is_but_for_times(&self, text: &str) -> bool {
        let parsed = |text: &str| {
            let mut value: serde_json::Value = serde_json::from_str(text).ok()?;
            value.as_object_mut()?.remove("seconds");
            Some(value)
        };
        parsed(text).is_some_and(|old| Some(old) == parsed(&self.json()))
    }

    pub(super) fn lines(&self) -> Vec<String> {
        let points = &self.points;
        let left_out = [
            (points.ignored, "NaN, infinite or negative values ignored"),
            (points.outside, "outside the image"),
            (points.hidden, "behind others"),
        ];
        let mut notes: Vec<String> = left_out
            .into_iter()
            .filter(|(count, _)| *count > 0)
            .map(|(count, what)| format!("{count} {what}"))
            .collect();
        if points.deviations_used == Some(false) {
            notes.push("their deviations play no part in this method".to_owned());
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
            lines.push(format!(
                "depth     {:.3} to {:.3} {m}, {}x{}",
                depth.lowest, depth.highest, depth.width, depth.height
            ));
        }
        if let Some(fit) = &self.fit {
            let left_out = fit.left_out.map_or(String::new(), |left_out| {
                format!(", {left_out:.4} {m} at points left out")
            });
            lines.push(format!(
                "residual  {:.4} {m} rms at the points{left_out}, rank {} of {}",
                fit.residual, fit.rank, fit.functions
            ));
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
