//! Which views of a sequence see the same.

use super::carry::seen;
use super::{PosedView, Projection, ViewSettings};

/// Points of a view that are tried.
const TRIED: usize = 64;
/// A neighbour shares at least this part of its view.
const LEAST: f64 = 0.05;

/// The indices of the views that share most with that of `index`, best first: by the smaller of both shares of points that
/// the other sees, occlusion aside, times the cosine of the angle between the optical axes. Of equals the nearest in the
/// sequence is first. Views that share less than a twentieth are none.
///
/// Views are tried from the nearest in the sequence on, each only until it can no longer be among the best: of thousands,
/// most cost a comparison of axes or a few points.
///
/// # Panics
/// An index that is none of a view.
pub fn neighbours(views: &[PosedView], index: usize, settings: &ViewSettings) -> Vec<usize> {
    let own = &views[index];
    // The nearest first: of equals, later ones come after.
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

/// How much two views share, if that is more than `most_of_others`, and enough for neighbours.
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

/// The share of the points of `other` that lie in the image of `own`; `None` as soon as it cannot be enough.
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

/// The direction of the optical axis of an image of `size` (width, height), of length 1.
pub(super) fn axis(camera: &dyn Projection, (width, height): (usize, usize)) -> Option<[f64; 3]> {
    let middle = [width, height].map(|length| 0.5 * (length as f64 - 1.0));
    let [from, to] = [0.0, 1.0].map(|depth| camera.unproject(middle, depth));
    let (from, to) = (from?, to?);
    let along = [0, 1, 2].map(|i| to[i] - from[i]);
    let length = along.iter().map(|v| v * v).sum::<f64>().sqrt();
    (length > 0.0).then(|| along.map(|v| v / length))
}
