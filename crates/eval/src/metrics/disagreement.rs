//! Disagreement between the depths of two views of a scene.

use crate::data::DepthMap;
use lsdc_core::Camera;
use lsdc_files::error::{Error, Result};

/// Largest relative difference of true depths that belong to the same surface.
const SAME_SURFACE: f64 = 0.01;
/// Distance, in pixels, below which a position snaps to a pixel centre, so that identical cameras map pixels to themselves.
const ROUNDING: f64 = 1e-6;

/// A predicted depth map with the truth.
#[derive(Clone, Copy, Debug)]
pub struct ViewDepths<'a> {
    /// The true camera, with its pose.
    pub camera: &'a Camera,
    /// The predicted depth map.
    pub predicted: &'a DepthMap,
    /// True depths, as large as the predicted ones.
    pub truth: &'a DepthMap,
}

/// Relative differences |a - b| / b of predicted depths: a is the depth of one view, warped into another view by both cameras,
/// and b is the depth of the other view at the warped position.
///
/// Only pixels visible in both views count: the true depth of one view, warped likewise, is within 1 % of the true depth of the
/// other. Hence occluded surfaces and moving objects do not count. For two frames of a static camera, the disagreement is the
/// flicker.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Disagreement {
    differences: Vec<f32>,
    unmatched: u64,
}

impl Disagreement {
    /// Compares the depths of two views. Depths of the second view are interpolated linearly in inverse depth, which is exact
    /// on planes.
    ///
    /// # Errors
    /// Predicted and true depths of different sizes.
    pub fn of(from: &ViewDepths<'_>, to: &ViewDepths<'_>) -> Result<Self> {
        check_sizes(from)?;
        check_sizes(to)?;
        let warp = |pixel: [f64; 2], depth: f64| {
            let point = from.camera.unproject(pixel, depth)?;
            to.camera.project(point)
        };
        let mut found = Self::default();
        for point in from.truth.points() {
            let pixel = [point.x as f64, point.y as f64];
            let Some((place, depth)) = warp(pixel, f64::from(point.depth)) else {
                continue;
            };
            let seen = interpolated(to.truth, place);
            if !seen.is_some_and(|seen| (depth - seen).abs() <= SAME_SURFACE * seen) {
                continue;
            }
            let predicted = from.predicted.at(point.x, point.y);
            let warped = (predicted > 0.0)
                .then(|| warp(pixel, f64::from(predicted)))
                .flatten();
            let pair = warped.and_then(|(place, a)| Some((a, interpolated(to.predicted, place)?)));
            match pair {
                Some((a, b)) => found.differences.push(((a - b).abs() / b) as f32),
                None => found.unmatched += 1,
            }
        }
        Ok(found)
    }

    /// Adds the pixels of another pair of views.
    pub fn add(&mut self, other: &Self) {
        self.differences.extend(&other.differences);
        self.unmatched += other.unmatched;
    }

    /// Returns the number of compared pixels.
    pub fn compared(&self) -> usize {
        self.differences.len()
    }

    /// Returns the number of pixels visible in both views whose predicted depth leads out of the other image or has no
    /// counterpart.
    pub fn unmatched(&self) -> u64 {
        self.unmatched
    }

    /// Returns the quantile of the differences for a share from 0 to 1, for example 0.5 for the median. `None` without compared
    /// pixels.
    pub fn quantile(&self, share: f64) -> Option<f64> {
        let last = self.differences.len().checked_sub(1)?;
        let rank = (share * self.differences.len() as f64).ceil() as usize;
        let mut sorted = self.differences.clone();
        let index = rank.saturating_sub(1).min(last);
        let (_, value, _) = sorted.select_nth_unstable_by(index, f32::total_cmp);
        Some(f64::from(*value))
    }
}

fn check_sizes(view: &ViewDepths<'_>) -> Result<()> {
    let [predicted, truth] = [view.predicted, view.truth].map(|map| (map.width(), map.height()));
    if predicted == truth {
        return Ok(());
    }
    Err(Error::shape(format!(
        "the predicted depths are {}x{} but the true depths {}x{}",
        predicted.0, predicted.1, truth.0, truth.1
    )))
}

/// Returns the depth at a position between pixel centres, which must all have a depth.
fn interpolated(map: &DepthMap, place: [f64; 2]) -> Option<f64> {
    let axis = |place: f64, length: usize| {
        let nearest = place.round();
        let place = if (place - nearest).abs() < ROUNDING {
            nearest
        } else {
            place
        };
        let low = place.floor();
        let within = low >= 0.0 && place <= length as f64 - 1.0;
        within.then_some((low as usize, place - low))
    };
    let (x, across) = axis(place[0], map.width())?;
    let (y, down) = axis(place[1], map.height())?;
    let mut inverse = 0.0;
    for (row, vertical) in [(y, 1.0 - down), (y + 1, down)] {
        for (column, horizontal) in [(x, 1.0 - across), (x + 1, across)] {
            let share = vertical * horizontal;
            if share > 0.0 {
                let depth = map.get(column, row).filter(|depth| *depth > 0.0)?;
                inverse += share / f64::from(depth);
            }
        }
    }
    Some(1.0 / inverse)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (usize, usize) = (64, 48);

    fn camera(x: f64, ahead: f64) -> Camera {
        let identity = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        Camera::pinhole([60.0, 60.0], [31.5, 23.5]).with_pose(identity, [-x, 0.0, -ahead])
    }

    /// Returns the depths of the plane z = 3 + slope x, in the world, times a factor.
    fn plane(camera: &Camera, slope: f64, factor: f64) -> DepthMap {
        let (_, [x, _, ahead]) = camera.pose();
        let depth = |i: usize| {
            let u = ((i % SIZE.0) as f64 - 31.5) / 60.0;
            // z + ahead = 3 + slope (u z + x), in the camera's axes.
            (factor * (3.0 + ahead - slope * x) / (1.0 - slope * u)) as f32
        };
        DepthMap::new(SIZE.0, SIZE.1, (0..SIZE.0 * SIZE.1).map(depth).collect()).unwrap()
    }

    fn disagreement(slope: f64, factors: [f64; 2]) -> Disagreement {
        let cameras = [camera(0.0, 0.0), camera(0.3, 0.5)];
        let truth = [0, 1].map(|i: usize| plane(&cameras[i], slope, 1.0));
        let predicted = [0, 1].map(|i: usize| plane(&cameras[i], slope, factors[i]));
        let [a, b] = [0, 1].map(|i: usize| ViewDepths {
            camera: &cameras[i],
            predicted: &predicted[i],
            truth: &truth[i],
        });
        Disagreement::of(&a, &b).unwrap()
    }

    #[test]
    fn exact_depths_of_a_slanted_plane_agree() {
        let found = disagreement(0.4, [1.0, 1.0]);
        assert!(found.quantile(1.0).unwrap() < 1e-6, "{found:?}");
        // The second view is 0.5 m ahead and sees 5/6 of the width and height.
        let share = found.compared() as f64 / (64.0 * 48.0);
        assert!(share > 0.5 && share < 0.8, "{share}");
        assert_eq!(found.unmatched(), 0);
    }

    #[test]
    fn offsets_have_their_closed_forms() {
        // At z = 3, predicted 10 % too far: 3.3 - 0.5 instead of 2.5.
        let found = disagreement(0.0, [1.1, 1.0]);
        for share in [0.01, 0.5, 0.9, 1.0] {
            assert!((found.quantile(share).unwrap() - 0.12).abs() < 1e-6);
        }
        // The second view is 5 % too far everywhere: |1 - 1.05| / 1.05.
        let found = disagreement(0.0, [1.0, 1.05]);
        assert!((found.quantile(0.5).unwrap() - 0.05 / 1.05).abs() < 1e-6);
    }

    #[test]
    fn depths_that_lead_out_of_the_image_are_counted() {
        // At half of the depth, points at the sides project outside the second image.
        let whole = disagreement(0.0, [1.0, 1.0]).compared() as u64;
        let found = disagreement(0.0, [0.5, 1.0]);
        assert!(found.unmatched() > 0);
        assert_eq!(found.compared() as u64 + found.unmatched(), whole);
    }

    #[test]
    fn what_one_view_does_not_see_does_not_count() {
        let camera = camera(0.0, 0.0);
        let flat = plane(&camera, 0.0, 1.0);
        // An object in front of the left half, in the second view only.
        let mut values = flat.values().to_vec();
        for (i, depth) in values.iter_mut().enumerate() {
            if i % SIZE.0 < 32 {
                *depth = 2.0;
            }
        }
        let occluded = DepthMap::new(SIZE.0, SIZE.1, values).unwrap();
        let view = |truth| ViewDepths {
            camera: &camera,
            predicted: &flat,
            truth,
        };
        let found = Disagreement::of(&view(&flat), &view(&occluded)).unwrap();
        assert_eq!((found.compared(), found.unmatched()), (32 * 48, 0));
        let small = DepthMap::empty(3, 3);
        assert!(Disagreement::of(&view(&flat), &view(&small)).is_err());
    }

    #[test]
    fn quantiles_are_ranks() {
        let mut found = Disagreement::default();
        assert_eq!(found.quantile(0.5), None);
        for difference in [0.5, 0.25] {
            found.add(&Disagreement {
                differences: vec![difference; 5],
                unmatched: 1,
            });
        }
        assert_eq!(found.quantile(0.5), Some(0.25));
        assert_eq!(found.quantile(0.51), Some(0.5));
        assert_eq!((found.compared(), found.unmatched()), (10, 2));
    }
}
