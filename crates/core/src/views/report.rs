//! Reports on the use of the points of other views.

use super::PosedView;
use super::carry::Carried;

/// A report on the use of the points of other views.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct ViewsReport {
    /// Whether carried points joined the fit.
    pub outcome: ViewsOutcome,
    /// One report for each of the other views, in order.
    pub views: Vec<ViewReport>,
    /// The mean relative leave-one-out error of the image's own points, without and with the carried points.
    pub errors: Option<[f64; 2]>,
}

/// Whether carried points joined a fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ViewsOutcome {
    /// Carried points were used.
    Used,
    /// No point of another view remains.
    NoPoints,
    /// The image has too few own points to check others.
    TooFewPoints,
    /// The carried points were rejected, because the image's own points are not predicted clearly better with them.
    Rejected,
}

/// Counts of the points of another view. `points` is the sum of the counts, except in inconsistent views: their points are
/// counted as occluded and contradicting with respect to the completion alone.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct ViewReport {
    /// Whether it is used.
    pub outcome: ViewOutcome,
    /// Number of its points.
    pub points: usize,
    /// Number of points outside the image, or without a usable depth.
    pub outside: usize,
    /// Number of points that the image, or an earlier view, also measured.
    pub doubled: usize,
    /// Number of points behind the visible surface of the image, or behind the surface spanned by the points around them.
    pub occluded: usize,
    /// Number of points in front of the visible surface of the image: something moved, or the pose is wrong.
    pub contradicting: usize,
    /// Number of points dropped to limit their total number.
    pub thinned: usize,
    /// Number of points used in the fit, unless all were rejected.
    pub carried: usize,
    /// The estimated standard deviation of the depths due to the error of the pose, relative to the depth.
    pub pose_deviation: f64,
}

/// Whether another view is used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ViewOutcome {
    /// Its points were carried over.
    Used,
    /// None of its points is inside the image, or the image measured all of them itself.
    NoOverlap,
    /// It contradicts the image's own points, as with a wrong pose.
    Inconsistent,
}

impl ViewReport {
    /// Counts a point that contradicts the completion by the image's own points, as occluded or contradicting.
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

    /// Number of points of other views used in the fit.
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
