//! Support for carried points that contradict the completion, from measured points around them.
//!
//! The completion by the image's own points is wrong where it missed a surface, so a point that contradicts it may be right. In
//! this case, other views measured the same surface with points of their own. If something moved, own points disagree with the
//! carried points around them, and the completion is trusted everywhere, because the moved object may be at pixels without own
//! points.

use super::PosedView;
use super::carry::Carried;
use super::report::ViewReport;
use crate::nearest::NeighbourGrid;
use crate::observations::Observation;

/// Relative difference of depths up to which two points may belong to one surface, without their standard deviations. In the
/// test for occlusion, 5 % has the same RMSE on procedural rooms, and a 3 % higher one on 7-Scenes; 20 % has a 10 % higher one
/// on rooms, and the same on 7-Scenes.
pub(super) const SAME_SURFACE: f64 = 0.1;
/// Additional tolerance for the difference of two depths, in their combined standard deviations.
const APART: f64 = 3.0;
/// Number of carried points around an own point, and the least share of them that agrees with it unless something moved.
const AROUND: usize = 8;
const AGREEING: f64 = 0.25;
/// Squared radius of the neighbourhood of a point, in units of the squared mean distance between own points.
const REACH: f64 = 2.0;

/// Removes the carried points that contradict the completion, unless a point of another view, or of the image, supports them.
/// All are removed if an own point disagrees with the carried points around it.
pub(super) fn check(own: &PosedView, carried: &mut Vec<Carried>, views: &mut [ViewReport]) {
    if carried.iter().all(|point| !point.is_doubtful) {
        return;
    }
    let measured = own.points_inside();
    let something_moved = any_disputed(&measured, carried);
    let others = Others::new(own, &measured, carried, views.len());
    let is_kept =
        |point: &Carried| !point.is_doubtful || (!something_moved && others.support(point));
    let mut kept = carried.iter().map(is_kept).collect::<Vec<_>>().into_iter();
    carried.retain(|point| {
        let is_kept = kept.next().unwrap_or(true);
        if !is_kept {
            views[point.view].count_doubtful(point);
        }
        is_kept
    });
}

/// Removes the carried points that contradict the completion.
pub(super) fn remove_doubtful(carried: &mut Vec<Carried>, views: &mut [ViewReport]) {
    carried.retain(|point| {
        if point.is_doubtful {
            views[point.view].count_doubtful(point);
        }
        !point.is_doubtful
    });
}

/// Whether the depths of a carried point and an observation agree within their standard deviations.
fn agrees(point: &Carried, other: &Observation) -> bool {
    let deviation = point.deviation.hypot(relative_deviation(other));
    let difference = f64::from(other.depth) / f64::from(point.observation.depth) - 1.0;
    difference.abs() < SAME_SURFACE.hypot(APART * deviation)
}

/// The relative standard deviation of a measured depth; 0 if it is unknown.
pub(super) fn relative_deviation(point: &Observation) -> f64 {
    let measured = point.sigma.filter(|sigma| *sigma > 0.0).unwrap_or(0.0);
    f64::from(measured) / f64::from(point.depth)
}

/// Returns the least relative difference from the completion at which a carried point belongs to another surface.
pub(super) fn tolerance(point: &Carried) -> f64 {
    SAME_SURFACE.hypot(APART * point.deviation)
}

fn place(point: &Observation) -> [f64; 2] {
    [point.u, point.v]
}

fn grid<'a>(points: impl Iterator<Item = &'a Observation>) -> NeighbourGrid {
    NeighbourGrid::new(&points.map(place).collect::<Vec<_>>())
}

/// Whether one of the image's own points disagrees with the carried points around it.
fn any_disputed(measured: &[Observation], carried: &[Carried]) -> bool {
    let around = grid(carried.iter().map(|point| &point.observation));
    measured.iter().any(|point| {
        let near = around.nearest(place(point), AROUND);
        let agreeing = near.iter().filter(|(_, index)| {
            let carried = &carried[*index];
            // The completion interpolates own points, and follows the slope around them.
            carried.difference.abs() < tolerance(carried) || agrees(carried, point)
        });
        (agreeing.count() as f64) < AGREEING * near.len() as f64
    })
}

/// The points of each view, followed by those of the image.
struct Others {
    views: Vec<(NeighbourGrid, Vec<Observation>)>,
    reach: f64,
}

impl Others {
    fn new(own: &PosedView, measured: &[Observation], carried: &[Carried], views: usize) -> Self {
        let mut points = vec![Vec::new(); views];
        for point in carried {
            points[point.view].push(point.observation);
        }
        points.push(measured.to_vec());
        let with_grid = |points: Vec<Observation>| (grid(points.iter()), points);
        let (width, height) = own.size();
        Self {
            views: points.into_iter().map(with_grid).collect(),
            reach: REACH * (width * height) as f64 / measured.len().max(1) as f64,
        }
    }

    /// Whether the nearest point of another view, or of the image, agrees with a point.
    fn support(&self, point: &Carried) -> bool {
        self.views.iter().enumerate().any(|(view, (grid, points))| {
            let nearest = grid.nearest(place(&point.observation), 1);
            view != point.view
                && nearest.first().is_some_and(|&(square, index)| {
                    square < self.reach && agrees(point, &points[index])
                })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Camera, Observations, ViewsReport};
    use super::*;

    const WALL: f32 = 3.0;

    /// Returns a view of a wall at 3 m, measured at every twelfth pixel.
    fn own(depth: impl Fn(usize, usize) -> f32) -> PosedView {
        let camera = Camera::pinhole([80.0; 2], [47.5, 35.5]);
        let places = (6..72)
            .step_by(12)
            .flat_map(|v| (6..96).step_by(12).map(move |u| (u, v)));
        let mut points = Observations::new();
        places.for_each(|(u, v)| points.add(u as f64, v as f64, depth(u, v)));
        PosedView::new(camera, 96, 72, points).unwrap()
    }

    /// Returns points of a view at every sixth pixel from the first, with their differences from the wall.
    fn carried(view: usize, first: usize, depth: impl Fn(usize, usize) -> f32) -> Vec<Carried> {
        let places = (first..72)
            .step_by(6)
            .flat_map(|v| (first..96).step_by(6).map(move |u| (u, v)));
        let point = |(index, (u, v))| {
            let depth: f32 = depth(u, v);
            let difference = f64::from(depth / WALL) - 1.0;
            Carried {
                observation: Observation::new(u as f64, v as f64, depth),
                view,
                index,
                difference,
                is_doubtful: difference.abs() > 0.06,
                deviation: 0.0,
            }
        };
        places.enumerate().map(point).collect()
    }

    /// Returns the number of kept points, and the numbers of removed points on both sides.
    fn checked(own: &PosedView, mut all: Vec<Carried>) -> (usize, [usize; 2]) {
        let mut report = ViewsReport::new(&[own, own]);
        check(own, &mut all, &mut report.views);
        let sum = |count: fn(&ViewReport) -> usize| report.views.iter().map(count).sum();
        (
            all.len(),
            [sum(|view| view.contradicting), sum(|view| view.occluded)],
        )
    }

    /// A box between four points of the image, which the completion misses.
    fn with_box(u: usize, v: usize) -> f32 {
        let is_box = (43..54).contains(&u) && (31..42).contains(&v);
        if is_box { 2.0 } else { WALL }
    }

    #[test]
    fn a_surface_between_own_points_is_kept_if_two_views_see_it() {
        let own = own(|_, _| WALL);
        let both = [carried(0, 1, with_box), carried(1, 3, with_box)].concat();
        let doubtful = both.iter().filter(|point| point.is_doubtful).count();
        assert!(doubtful >= 6, "{doubtful}");
        let all = both.len();
        assert_eq!(checked(&own, both), (all, [0, 0]));
        // A single view, as of something that moved.
        let one = [carried(0, 1, with_box), carried(1, 3, |_, _| WALL)].concat();
        let doubtful = one.iter().filter(|point| point.is_doubtful).count();
        assert_eq!(checked(&own, one), (all - doubtful, [doubtful, 0]));
    }

    #[test]
    fn own_points_are_right_where_all_views_disagree() {
        // An object is present now that was absent when the other images were taken.
        let moved = |u: usize, v: usize| (30..66).contains(&u) && (18..54).contains(&v);
        let own = own(|u, v| if moved(u, v) { 1.5 } else { WALL });
        let views = [carried(0, 1, |_, _| WALL), carried(1, 3, |_, _| WALL)].concat();
        // The completion is 1.5 m there.
        let against = |point: Carried| {
            let is_there = moved(point.observation.u as usize, point.observation.v as usize);
            let difference = if is_there { 1.0 } else { 0.0 };
            Carried {
                difference,
                is_doubtful: is_there,
                ..point
            }
        };
        let views: Vec<Carried> = views.into_iter().map(against).collect();
        let (all, there) = (
            views.len(),
            views.iter().filter(|point| point.is_doubtful).count(),
        );
        assert!(there > 60, "{there}");
        assert_eq!(checked(&own, views), (all - there, [0, there]));
    }

    #[test]
    fn deviations_widen_what_agrees() {
        let point = carried(0, 1, |_, _| WALL)[0];
        let other = Observation::new(0.0, 0.0, 1.2 * WALL);
        assert!(!agrees(&point, &other));
        let vague = Observation {
            sigma: Some(0.2),
            ..other
        };
        // sqrt(0.1^2 + (3 x 0.2 / 3.6)^2) = 0.194, and 0.21 with the pose.
        assert!(!agrees(&point, &vague));
        let point = Carried {
            deviation: 0.03,
            ..point
        };
        assert!(agrees(&point, &vague));
    }
}
