//! Which views of a sequence see the same.

use super::carry::seen;
use super::{PosedView, ViewSettings};

/// Points of a view that are tried.
const TRIED: usize = 64;
/// A neighbour shares at least this part of its view.
const LEAST: f64 = 0.05;

/// The indices of the views that share most with that of `index`, best first: by the smaller of both shares of points that the
/// other sees, occlusion aside, times the cosine of the angle between the optical axes. Of equals the nearest in the sequence is
/// first. Views that share less than a twentieth are none.
///
/// # Panics
/// An index that is none of a view.
pub fn neighbours(views: &[PosedView], index: usize, settings: &ViewSettings) -> Vec<usize> {
    let own = &views[index];
    let end = if settings.only_past {
        index
    } else {
        views.len()
    };
    let axis = own.axis();
    let score = |other: &PosedView| {
        let cosine = axis.zip(other.axis()).map_or(0.0, |(a, b)| {
            a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>()
        });
        if cosine <= 0.0 {
            return 0.0;
        }
        let to = share(own, other);
        if to < LEAST {
            0.0
        } else {
            cosine * to.min(share(other, own))
        }
    };
    let others = (0..end).filter(|&other| other != index);
    let scored = others.map(|other| (score(&views[other]), other));
    let mut found: Vec<(f64, usize)> = scored.filter(|(score, _)| *score >= LEAST).collect();
    let away = |other: usize| (other.abs_diff(index), other);
    found.sort_by(|a, b| b.0.total_cmp(&a.0).then(away(a.1).cmp(&away(b.1))));
    found.truncate(settings.count);
    found.into_iter().map(|(_, other)| other).collect()
}

/// The share of the points of `other` that lie in the image of `own`.
fn share(own: &PosedView, other: &PosedView) -> f64 {
    let points = other.observations().as_slice();
    let tried = points.iter().step_by(points.len().div_ceil(TRIED).max(1));
    let count = tried.len().max(1);
    let seen = tried.filter(|point| seen(own, other, point).is_some());
    seen.count() as f64 / count as f64
}

impl PosedView {
    /// The direction of the optical axis, of length 1.
    fn axis(&self) -> Option<[f64; 3]> {
        let middle = [self.width, self.height].map(|length| 0.5 * (length as f64 - 1.0));
        let [from, to] = [0.0, 1.0].map(|depth| self.camera.unproject(middle, depth));
        let (from, to) = (from?, to?);
        let along = [0, 1, 2].map(|i| to[i] - from[i]);
        let length = along.iter().map(|v| v * v).sum::<f64>().sqrt();
        (length > 0.0).then(|| along.map(|v| v / length))
    }
}
