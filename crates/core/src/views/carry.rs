//! Projection of the points of other views into the image of this one.

use super::{PosedView, ViewOutcome, ViewReport};
use crate::cloud::pixel;
use crate::observations::Observation;
use std::collections::HashSet;

/// A point of another view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Carried {
    /// Its position, depth and standard deviation in this image.
    pub(super) observation: Observation,
    /// The index of its view, and its own index in that view.
    pub(super) view: usize,
    pub(super) index: usize,
    /// Its depth relative to the completion by the image's own points, minus 1.
    pub(super) difference: f64,
    /// Whether it contradicts the completion.
    pub(super) is_doubtful: bool,
    /// The relative standard deviation of its depth, from its measurement and the error of the pose.
    pub(super) deviation: f64,
}

/// Returns every point of the other views that is inside this image, except points that the image measures itself. Standard
/// deviations of depths are kept, because a rigid motion preserves lengths.
pub(super) fn carry(
    own: &PosedView,
    others: &[&PosedView],
    views: &mut [ViewReport],
) -> Vec<Carried> {
    let measured: HashSet<u64> = own.points.ids.iter().flatten().copied().collect();
    let mut carried = Vec::new();
    for (view, (other, report)) in others.iter().zip(views).enumerate() {
        let before = carried.len();
        for (index, point) in other.observations().iter().enumerate() {
            let Some(observation) = seen(own, other, point) else {
                report.outside += 1;
                continue;
            };
            if other.id(index).is_some_and(|id| measured.contains(&id)) {
                report.doubled += 1;
                continue;
            }
            carried.push(Carried {
                observation,
                view,
                index,
                difference: 0.0,
                is_doubtful: false,
                deviation: 0.0,
            });
        }
        if carried.len() > before {
            report.outcome = ViewOutcome::Used;
        }
    }
    carried
}

/// Projects a point of another view into this image; `None` if it is outside.
pub(super) fn seen(own: &PosedView, other: &PosedView, point: &Observation) -> Option<Observation> {
    let depth = f64::from(point.depth);
    if !(depth > 0.0 && depth.is_finite()) {
        return None;
    }
    let place = other.camera.unproject([point.u, point.v], depth)?;
    let ([u, v], depth) = own.camera.project(place)?;
    pixel([u, v], own.size())?;
    Some(Observation {
        u,
        v,
        depth: depth as f32,
        sigma: point.sigma,
    })
}

/// Of points measured by several views, keeps only that of the first view.
pub(super) fn remove_doubled(
    others: &[&PosedView],
    carried: &mut Vec<Carried>,
    views: &mut [ViewReport],
) {
    let mut known = HashSet::new();
    carried.retain(|point| {
        let id = others[point.view].id(point.index);
        let is_new = id.is_none_or(|id| known.insert(id));
        views[point.view].doubled += usize::from(!is_new);
        is_new
    });
}
