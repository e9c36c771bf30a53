//! Statistics of the node, and their diagnostics message.

use crate::engine::Facts;
use crate::past::Carried;
use crate::quality::Level;
use lsdc_recordings::{DiagnosticLevel, DiagnosticStatus, DropReason, LiveCounts};
use std::collections::BTreeMap;
use std::time::Duration;

/// Statistics of a node. Each received image has been completed, left out for a reason, or still waits.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NodeStatus {
    /// Images received.
    pub images: u64,
    /// Images whose depth was published.
    pub completed: u64,
    /// Images without depth, by kind of reason.
    pub left_out: BTreeMap<&'static str, u64>,
    /// Reason for the last of them.
    pub last_reason: Option<String>,
    /// Dropped messages other than images: they arrived faster than they were handled.
    pub lost: u64,
    /// Results that could not be published.
    pub unpublished: u64,
    /// Counts of rejected camera infos, points and transforms.
    pub inputs: LiveCounts,
    /// Images completed without points of earlier ones though these are wanted: the place of the camera was not known, or quality
    /// was lowered.
    pub alone: u64,
    /// Why no image can be completed at the moment, if so.
    pub lacking: Option<String>,
    /// Assumptions to check, one sentence each.
    pub remarks: Vec<String>,
    /// Quality of the next image; `None` before the first.
    pub quality: Option<Level>,
    /// Images that missed the deadline.
    pub late: u64,
    /// Time from when the last image and its points were available until its depth was published.
    pub latency: Option<Duration>,
    /// Time from when the last image was received until its depth was published.
    pub age: Option<Duration>,
    pub(crate) facts: Facts,
}

impl NodeStatus {
    /// Images neither completed nor left out yet.
    pub fn waiting(&self) -> u64 {
        self.images
            .saturating_sub(self.completed + self.left_out.values().sum::<u64>())
    }

    pub(crate) fn leave_out(&mut self, kind: &'static str, reason: String) {
        *self.left_out.entry(kind).or_default() += 1;
        self.last_reason = Some(reason);
    }

    pub(crate) fn drop_image(&mut self, reason: &DropReason) {
        self.leave_out(reason.kind(), reason.to_string());
    }

    /// The state of the node after that of some time ago.
    pub(crate) fn diagnostic(
        &self,
        before: &Self,
        name: &str,
        image_topic: &str,
    ) -> DiagnosticStatus {
        let images = self.images - before.images;
        let completed = self.completed - before.completed;
        let left_out = |status: &Self| status.left_out.values().sum::<u64>();
        let missed = left_out(self) - left_out(before);
        let lowered = self.quality.filter(|level| *level > Level::Full);
        let reason = self.last_reason.as_deref().unwrap_or_default();
        let (level, message) = if images == 0 && completed == 0 {
            let message = format!("no images on {image_topic}");
            (DiagnosticLevel::Stale, message)
        } else if let (0, Some(lacking)) = (completed, &self.lacking) {
            (DiagnosticLevel::Error, lacking.clone())
        } else if completed == 0 && missed > 0 {
            (DiagnosticLevel::Error, format!("no depth: {reason}"))
        } else if self.unpublished > before.unpublished {
            let message = "results could not be published".to_owned();
            (DiagnosticLevel::Error, message)
        } else if missed > 0 {
            let message = format!("{missed} of {images} images left out: {reason}");
            (DiagnosticLevel::Warn, message)
        } else if let Some(lowered) = lowered {
            let message = format!("quality lowered to keep the latency: {}", lowered.name());
            (DiagnosticLevel::Warn, message)
        } else if let Some(remark) = self.remarks.first().or(self.facts.remarks.first()) {
            (DiagnosticLevel::Warn, remark.clone())
        } else {
            (DiagnosticLevel::Ok, format!("{completed} images completed"))
        };
        DiagnosticStatus {
            level,
            name: format!("{name}: depth completion"),
            message,
            hardware_id: name.to_owned(),
            values: self.values(),
        }
    }

    fn values(&self) -> Vec<(String, String)> {
        let mut values = Vec::new();
        let mut add = |name: &str, value: String| values.push((name.to_owned(), value));
        add("images", self.images.to_string());
        add("completed", self.completed.to_string());
        for (kind, count) in &self.left_out {
            add(kind, count.to_string());
        }
        let milliseconds = |time: Duration| format!("{:.1} ms", time.as_secs_f64() * 1e3);
        if let Some(latency) = self.latency {
            add("latency", milliseconds(latency));
        }
        if let Some(age) = self.age {
            add("age of the image", milliseconds(age));
        }
        if let Some(quality) = self.quality {
            add("quality", quality.name().to_owned());
        }
        if self.completed > 0 {
            let Facts {
                given,
                used,
                residual,
                ..
            } = self.facts;
            add("points", given.to_string());
            add("points used", used.to_string());
            add("residual", format!("{residual:.4} m"));
        }
        if let Some(outliers) = self.facts.outliers {
            add("outliers", outliers.to_string());
        }
        if let Some(carried) = self.facts.carried {
            let Carried {
                points,
                considered,
                inconsistent,
            } = carried;
            add("points of earlier images", points.to_string());
            add("earlier images", considered.to_string());
            add("earlier images that contradict", inconsistent.to_string());
        }
        let inputs = self.inputs;
        let counts = [
            ("images that took too long", self.late),
            ("images without points of earlier ones", self.alone),
            ("messages lost", self.lost),
            ("results not published", self.unpublished),
            ("points left out by quality", self.facts.thinned as u64),
            ("points without a place", self.facts.unplaced as u64),
            ("pixels beyond 65.535 m", self.facts.beyond as u64),
            ("pixels of sky without a point", self.facts.sky as u64),
            ("damaged messages of points", inputs.damaged_points),
            ("unusable messages of cameras", inputs.unusable_cameras),
            ("damaged transforms", inputs.unusable_transforms),
            ("transforms of another parent", inputs.reparented),
            ("static transforms replaced", inputs.replaced),
            ("transforms of too many frames", inputs.crowded),
            ("messages without a stamp", inputs.unstamped),
            ("clock set back", inputs.set_back),
            ("messages too large", inputs.too_large),
        ];
        for (name, count) in counts.into_iter().filter(|(_, count)| *count > 0) {
            add(name, count.to_string());
        }
        for remark in self.remarks.iter().chain(&self.facts.remarks) {
            add("remark", remark.clone());
        }
        values
    }
}
