//! Views of a sequence with overlapping fields of view.

use super::carry::seen;
use super::{PosedView, Projection, ViewSettings};

/// Number of points of a view that are projected.
const TRIED: usize = 64;
/// Least overlap of neighbours.
const LEAST: f64 = 0.05;

/// The indices of the views with the largest overlap with view `index`, best first. The overlap is the smaller of both shares
/// of points that are in the other image, ignoring occlusion, times the cosine of the angle between the optical axes. Ties are
/// ordered by the distance in the sequence. Views with an overlap below a twentieth are not neighbours.
///
/// Views are tested in the order of their distance in the sequence, and each test ends as soon as the view cannot be among the
/// best: for most of thousands of views, it only compares axes or projects a few points.
///
/// # Panics
/// The index is out of range.
pub fn neighbours(views: &[PosedView], index: usize, settings: &ViewSettings) -> Vec<usize> {
    let own = &views[index];
    // Nearest first: a later view follows earlier ones with the same overlap.
    let mut found: Vec<(f64, usize)> =
        Vec::with_capacity(settings.count.saturating_add(1).min(views.len()));
    let ahead = views.len() - 1 - index;
    let farthest = if settings.only_past {
        index
    } else {
        index.max(ahead)
    };
    for away in 1..=farthest {
        let after = (away <= ahead && !settings.only_past).then_some(index + away);
        for other in index.checked_sub(away).into_iter().chain(after) {
            let least = match found.last() {
                Some(last) if found.len() >= settings.count => last.0,
                _ => 0.0,
            };
            if let Some(score) = score(own, &views[other], least) {
                let place = found.partition_point(|better| better.0 >= score);
                found.insert(place, (score, other));
                found.truncate(settings.count);
            }
        }
    }
    found.into_iter().map(|(_, other)| other).collect()
}

/// Returns the overlap of two views; `None` if it is not larger than `most_of_others`, or too small for neighbours.
fn score(own: &PosedView, other: &PosedView, most_of_others: f64) -> Option<f64> {
    let (a, b) = own.axis.zip(other.axis)?;
    let cosine = a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let is_enough = |share: f64| {
        let score = cosine * share;
        share >= LEAST && score >= LEAST && score > most_of_others
    };
    if !is_enough(1.0) {
        return None;
    }
    let to = share(own, other, is_enough)?;
    let from = share(other, own, is_enough)?;
    Some(cosine * to.min(from))
}

/// Returns the share of the points of `other` inside the image of `own`; `None` as soon as it cannot be large enough.
fn share(own: &PosedView, other: &PosedView, is_enough: impl Fn(f64) -> bool) -> Option<f64> {
    let points = other.observations().as_slice();
    let tried = points.iter().step_by(points.len().div_ceil(TRIED).max(1));
    let count = tried.len().max(1);
    let most = |missed: usize| (count - missed) as f64 / count as f64;
    let mut missed = count - tried.len();
    for point in tried {
        if seen(own, other, point).is_none() {
            missed += 1;
            if !is_enough(most(missed)) {
                return None;
            }
        }
    }
    let share = most(missed);
    is_enough(share).then_some(share)
}

/// Returns the direction of the optical axis of an image of `size` (width, height), a unit vector.
pub(super) fn axis(camera: &dyn Projection, (width, height): (usize, usize)) -> Option<[f64; 3]> {
    let middle = [width, height].map(|length| 0.5 * (length as f64 - 1.0));
    let [from, to] = [0.0, 1.0].map(|depth| camera.unproject(middle, depth));
    let (from, to) = (from?, to?);
    let along = [0, 1, 2].map(|i| to[i] - from[i]);
    let length = along.iter().map(|v| v * v).sum::<f64>().sqrt();
    (length > 0.0).then(|| along.map(|v| v / length))
}
