//! Counts of the points carried over from other images.

use super::FrameViews;
use crate::cli::ui::counted;
use lsdc_core::{ViewOutcome, ViewsOutcome, ViewsReport};
use serde::Serialize;

impl FrameViews {
    /// The report in numbers.
    pub(in crate::cli::complete) fn described(&self, report: &ViewsReport) -> DescribedViews {
        let names = self.others.iter().map(|view| &view.name);
        let views = names.zip(&report.views).map(|(name, view)| DescribedView {
            image: name.display().to_string(),
            outcome: match view.outcome {
                ViewOutcome::Used => "used",
                ViewOutcome::Inconsistent => "inconsistent",
                _ => "no overlap",
            },
            carried: view.carried,
            occluded: view.occluded,
            contradicting: view.contradicting,
            pose_deviation: view.pose_deviation,
        });
        let sum = |count: fn(&lsdc_core::ViewReport) -> usize| {
            report.views.iter().map(count).sum::<usize>()
        };
        DescribedViews {
            outcome: match report.outcome {
                ViewsOutcome::Used => "used",
                ViewsOutcome::TooFewPoints => "too few points of its own",
                ViewsOutcome::Rejected => "rejected",
                _ => "no points",
            },
            considered: report.views.len(),
            used: report.count(ViewOutcome::Used),
            inconsistent: report.count(ViewOutcome::Inconsistent),
            carried: report.carried(),
            occluded: sum(|view| view.occluded),
            contradicting: sum(|view| view.contradicting),
            doubled: sum(|view| view.doubled),
            thinned: sum(|view| view.thinned),
            errors: report.errors,
            images: views.collect(),
        }
    }
}

/// Counts of the points of other images.
#[derive(Debug, Serialize)]
pub(in crate::cli::complete) struct DescribedViews {
    pub(in crate::cli::complete) outcome: &'static str,
    /// Neighbours, those that agree with the image, and those that contradict it.
    pub(in crate::cli::complete) considered: usize,
    pub(in crate::cli::complete) used: usize,
    pub(in crate::cli::complete) inconsistent: usize,
    /// Points that joined the fit, and those that did not.
    pub(in crate::cli::complete) carried: usize,
    pub(in crate::cli::complete) occluded: usize,
    pub(in crate::cli::complete) contradicting: usize,
    pub(in crate::cli::complete) doubled: usize,
    pub(in crate::cli::complete) thinned: usize,
    /// Mean relative leave-one-out errors of the image's own points, without and with the others.
    #[serde(skip_serializing_if = "Option::is_none")]
    errors: Option<[f64; 2]>,
    images: Vec<DescribedView>,
}

#[derive(Debug, Serialize)]
struct DescribedView {
    image: String,
    outcome: &'static str,
    carried: usize,
    occluded: usize,
    contradicting: usize,
    pose_deviation: f64,
}

impl DescribedViews {
    /// Returns a warning about points that were left out, with what to check.
    pub(in crate::cli::complete) fn remark(&self) -> Option<String> {
        let check = "check poses and time stamps";
        let errors = self.errors.filter(|[before, after]| after > before);
        if let Some([before, after]) = errors.filter(|_| self.outcome == "rejected") {
            let carried: usize = self.images.iter().map(|view| view.carried).sum();
            let are_wrong = self.images.iter().any(|view| view.pose_deviation > 0.0);
            let cause = if are_wrong || self.inconsistent > 0 {
                format!(
                    "{check}; if they are right, surfaces are rougher than the points are dense"
                )
            } else {
                "no error of the poses is found; surfaces may be rougher than the points are dense"
                    .to_owned()
            };
            return Some(format!(
                "{} of other images are left out, as the leave-one-out errors of the image's own points rise from {:.2} to \
                 {:.2} % with them: {cause}",
                counted(carried, "point"),
                100.0 * before,
                100.0 * after
            ));
        }
        (self.inconsistent > 0).then(|| {
            format!(
                "{} of {} contradict its points and are left out: {check}",
                self.inconsistent,
                counted(self.considered, "other image")
            )
        })
    }
}
