//! Points of other views in the image of this one.

use super::{PosedView, ViewOutcome, ViewReport};
use crate::cloud::pixel;
use crate::observations::Observation;
use std::collections::HashSet;

/// A point of another view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Carried {
    /// Its place, depth and standard deviation in this image.
    pub(super) observation: Observation,
    /// The index of its view, and its own index there.
    pub(super) view: usize,
    pub(super) index: usize,
    /// Its depth relative to the completion by the image's own points, minus 1.
    pub(super) difference: f64,
    /// Whether the completion contradicts it.
    pub(super) is_doubtful: bool,
    /// The relative standard deviation of its depth by its measurement and the error of the pose.
    pub(super) deviation: f64,
}

/// Every point of the other views that lies in this image, except those that it measures itself. A rigid motion changes no
/// length: the standard deviation of a depth stays.
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

/// A point of another view in this image, if it lies there.
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

/// Keeps one of the points that several views measured, that of the first of them.
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
