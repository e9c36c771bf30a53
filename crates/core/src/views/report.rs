//! What became of the points of other views.

use super::PosedView;
use super::carry::Carried;

/// What became of the points of other views.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct ViewsReport {
    /// Whether carried points joined the fit.
    pub outcome: ViewsOutcome,
    /// One for each of the other views, in their order.
    pub views: Vec<ViewReport>,
    /// The mean relative leave-one-out error of the image's own points, without and with the carried ones.
    pub errors: Option<[f64; 2]>,
}

/// Whether carried points joined a fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ViewsOutcome {
    /// They did.
    Used,
    /// No point of another view is left to join.
    NoPoints,
    /// The image has too few points of its own to check others.
    TooFewPoints,
    /// They did not, because the image's own points are not predicted clearly better with them.
    Rejected,
}

/// Counts of the points of another view: `points` is the sum of the counts, except in views that are inconsistent, whose
/// points are counted as occluded and contradicting by the completion alone.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct ViewReport {
    /// Whether it is used.
    pub outcome: ViewOutcome,
    /// Number of its points.
    pub points: usize,
    /// Number of points outside the image, or without a usable depth.
    pub outside: usize,
    /// Number of points that the image, or a view before, measured too.
    pub doubled: usize,
    /// Number of points behind the surface that the image sees, or that the points around them span.
    pub occluded: usize,
    /// Number of points in front of the surface that the image sees: something moved, or the pose is wrong.
    pub contradicting: usize,
    /// Number of points that were left out because there are many.
    pub thinned: usize,
    /// Number of points that joined the fit, unless all were rejected.
    pub carried: usize,
    /// The estimated standard deviation of the depths by the error of the pose, relative to the depth.
    pub pose_deviation: f64,
}

/// Whether another view is used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ViewOutcome {
    /// Its points were carried over.
    Used,
    /// The image sees none of its points, or measured them itself.
    NoOverlap,
    /// It contradicts the image's own points, as with a wrong pose.
    Inconsistent,
}

impl ViewReport {
    /// Counts a point that the completion by the image's own points contradicts, by the side where it lies.
    pub(super) fn count_doubtful(&mut self, point: &Carried) {
        if point.difference > 0.0 {
            self.occluded += 1;
        } else {
            self.contradicting += 1;
        }
    }
}

impl ViewsReport {
    pub(super) fn new(others: &[&PosedView]) -> Self {
        let view = |other: &&PosedView| ViewReport {
            outcome: ViewOutcome::NoOverlap,
            points: other.observations().len(),
            outside: 0,
            doubled: 0,
            occluded: 0,
            contradicting: 0,
            thinned: 0,
            carried: 0,
            pose_deviation: 0.0,
        };
        Self {
            outcome: ViewsOutcome::NoPoints,
            views: others.iter().map(view).collect(),
            errors: None,
        }
    }

    /// Number of points of other views that joined the fit.
    pub fn carried(&self) -> usize {
        match self.outcome {
            ViewsOutcome::Used => self.views.iter().map(|view| view.carried).sum(),
            _ => 0,
        }
    }

    /// Number of views with this outcome.
    pub fn count(&self, outcome: ViewOutcome) -> usize {
        let found = self.views.iter().filter(|view| view.outcome == outcome);
        found.count()
    }
}
