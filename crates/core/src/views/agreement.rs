//! Consistency of the points of other views with the completion by the image's own points.

use super::carry::Carried;
use super::report::{ViewOutcome, ViewReport};
use super::support::relative_deviation;
use crate::completion::Completion;
use crate::error::Result;
use crate::fit::student_t::{ONE_DEVIATION, bound, neg_log_likelihood};
use crate::map::DepthMap;
use crate::standard_deviation::NORMAL;

/// Points that differ by more standard deviations belong to another surface.
const APART: f64 = 3.0;
/// Share of points on other surfaces, and the density of their depths relative to that of this surface: uniform from 0 to twice
/// its depth.
const ELSEWHERE: f64 = 0.1;
const DENSITY: f64 = 0.5;
/// Relative standard deviations tested: the smallest, the ratio between successive ones, and their number.
const LEAST: f64 = 0.002;
const RATIO: f64 = 1.25;
const STEPS: i32 = 28;
/// Least gain in log-likelihood for a deviation other than 0.
const EVIDENCE: f64 = 2.0;
/// A view is rejected if its deviation is larger, or if a larger share of its points is in front of the image's surface.
const LARGEST: f64 = 0.1;
const CONTRADICTING: f64 = 0.3;

/// The difference of a carried point from the depth predicted by the image's own points, and its standard deviation without the
/// error of the pose, both relative to the predicted depth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Agreement {
    /// Positive if the point is farther away.
    pub(super) difference: f64,
    pub(super) deviation: f64,
}

impl Agreement {
    /// Whether a point of a view with this pose deviation belongs to another surface than the completion.
    pub(super) fn is_apart(&self, pose_deviation: f64) -> bool {
        self.difference.abs() > APART * self.deviation.hypot(pose_deviation)
    }
}

/// Estimates the deviation of each view, marks the points that contradict the completion, and removes all points of views that
/// contradict the image.
pub(super) fn check(
    alone: &Completion,
    deviations: &DepthMap,
    carried: &mut Vec<Carried>,
    views: &mut [ViewReport],
) -> Result<()> {
    let agreements = agreements(alone, deviations, carried)?;
    let freedom = alone.freedom().unwrap_or(NORMAL);
    let mut kept = Vec::with_capacity(carried.len());
    for (view, report) in views.iter_mut().enumerate() {
        let pairs = carried.iter().zip(&agreements);
        let of_view = pairs.filter(|(point, _)| point.view == view);
        let (mut points, all): (Vec<Carried>, Vec<Agreement>) = of_view
            .map(|(point, agreement)| (*point, *agreement))
            .unzip();
        if all.is_empty() {
            continue;
        }
        let pose_deviation = pose_deviation(&all, freedom);
        report.pose_deviation = pose_deviation;
        for (point, agreement) in points.iter_mut().zip(&all) {
            point.difference = agreement.difference;
            point.is_doubtful = agreement.is_apart(pose_deviation);
            point.deviation = relative_deviation(&point.observation).hypot(pose_deviation);
        }
        let doubtful = || points.iter().filter(|point| point.is_doubtful);
        let in_front = doubtful().filter(|point| point.difference < 0.0).count();
        let share = in_front as f64 / all.len() as f64;
        if pose_deviation > LARGEST || share > CONTRADICTING {
            report.outcome = ViewOutcome::Inconsistent;
            doubtful().for_each(|point| report.count_doubtful(point));
            continue;
        }
        kept.extend(points);
    }
    *carried = kept;
    Ok(())
}

/// Compares all carried points with the completion, in their order.
fn agreements(
    alone: &Completion,
    deviations: &DepthMap,
    carried: &[Carried],
) -> Result<Vec<Agreement>> {
    let places: Vec<[f64; 2]> = carried
        .iter()
        .map(|point| [point.observation.u, point.observation.v])
        .collect();
    let agreement = |(point, predicted): (&Carried, f32)| {
        let observation = &point.observation;
        let [x, y] = [observation.u, observation.v].map(|v| v.round().max(0.0) as usize);
        let of_fit = deviations.at(
            x.min(deviations.width() - 1),
            y.min(deviations.height() - 1),
        );
        let measured = observation.sigma.filter(|sigma| *sigma > 0.0);
        let measured = f64::from(measured.unwrap_or(0.0));
        let predicted = f64::from(predicted);
        Agreement {
            difference: f64::from(observation.depth) / predicted - 1.0,
            deviation: f64::from(of_fit).hypot(measured) / predicted,
        }
    };
    Ok(carried
        .iter()
        .zip(alone.at(&places)?)
        .map(agreement)
        .collect())
}

/// Returns the maximum-likelihood estimate of the standard deviation, relative to the depth, that the points of a view have in
/// addition to the known ones. Standardised differences follow Student's t distribution with `freedom` degrees of freedom, or
/// belong to other surfaces.
fn pose_deviation(all: &[Agreement], freedom: f64) -> f64 {
    let unit = bound(ONE_DEVIATION, freedom);
    let log_likelihood = |pose: f64| {
        let points = all.iter().map(|one| {
            let scale = one.deviation.hypot(pose) / unit;
            let square = (one.difference / scale).powi(2);
            let density = (-neg_log_likelihood(square, freedom)).exp() / scale;
            ((1.0 - ELSEWHERE) * density + ELSEWHERE * DENSITY).ln()
        });
        points.sum::<f64>()
    };
    let tried = (0..STEPS).map(|step| LEAST * RATIO.powi(step));
    let scored = tried.map(|pose| (log_likelihood(pose) - EVIDENCE, pose));
    let none = (log_likelihood(0.0), 0.0);
    let best = scored.fold(
        none,
        |best, tried| if tried.0 > best.0 { tried } else { best },
    );
    best.1
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsdc_rng::Rng;

    /// Draws points whose differences are normal with a known deviation and a pose deviation, and a share of points on another
    /// surface.
    fn points(pose: f64, elsewhere: f32) -> Vec<Agreement> {
        let mut rng = Rng::stream(3, &["agreement"]);
        let point = |_| {
            let deviation = f64::from(rng.range(0.01, 0.05));
            let difference = f64::from(rng.normal()) * deviation.hypot(pose);
            let other = f64::from(rng.range(0.3, 0.9));
            Agreement {
                difference: if rng.chance(elsewhere) {
                    other
                } else {
                    difference
                },
                deviation,
            }
        };
        (0..600).map(point).collect()
    }

    #[test]
    fn the_deviation_of_a_pose_is_found_whatever_is_occluded() {
        assert_eq!(pose_deviation(&points(0.0, 0.0), NORMAL), 0.0);
        assert_eq!(pose_deviation(&points(0.0, 0.15), NORMAL), 0.0);
        for pose in [0.03, 0.1] {
            for elsewhere in [0.0, 0.15] {
                let found = pose_deviation(&points(pose, elsewhere), NORMAL);
                // Tolerance: one step of the grid, and the sampling error of 600 points.
                assert!(
                    (found / pose).ln().abs() < 0.25,
                    "{pose} {elsewhere}: {found}"
                );
            }
        }
    }

    #[test]
    fn points_beyond_three_deviations_are_apart() {
        let at = |difference| Agreement {
            difference,
            deviation: 0.03,
        };
        let is_apart = [0.1, 0.08, 0.0, -0.08, -0.1].map(|difference| at(difference).is_apart(0.0));
        assert_eq!(is_apart, [true, false, false, false, true]);
        // 0.05 including the deviation of the pose.
        assert!(!at(0.1).is_apart(0.04));
    }
}
