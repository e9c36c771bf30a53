//! The covariance of triangulated points.

use super::Camera;
use super::records::Landmark;
use crate::pose::{cross, dot};
use std::collections::HashMap;

/// Points nearer to a camera than this, relative to others, are at its centre up to rounding.
pub(super) const CENTRE: f64 = 1e-6;

/// A covariance matrix of a position in the world, row by row.
pub(super) type Covariance = [[f64; 3]; 3];

/// Returns the covariance of a point, from the images that see it; `None` if they do not determine it. `cameras` has the camera
/// of each image at its pose. Poses and cameras are taken as exact, and images whose camera model is not supported are ignored.
///
/// With the Jacobian J of the pixel with respect to the position, and the standard deviation s of keypoints, it is the inverse
/// of the sum of J^T J / s^2 over images (backward propagation of covariance, Hartley and Zisserman 2004, section 5.2).
pub(super) fn covariance(
    landmark: &Landmark,
    cameras: &HashMap<u64, Camera>,
) -> Option<Covariance> {
    let mut images = landmark.images.clone();
    images.sort_unstable();
    // A wrong match may have a point twice in an image.
    images.dedup();
    let cameras = images.iter().filter_map(|image| cameras.get(image));
    let jacobians: Vec<_> = cameras
        .filter_map(|camera| jacobian(camera, landmark.position))
        .collect();
    let farthest = jacobians
        .iter()
        .fold(0.0_f64, |most, (_, depth)| most.max(*depth));
    let (mut information, mut count) = ([[0.0; 3]; 3], 0);
    for (rows, _) in jacobians
        .iter()
        .filter(|(_, depth)| *depth > CENTRE * farthest)
    {
        count += 1;
        for (i, values) in information.iter_mut().enumerate() {
            for (j, value) in values.iter_mut().enumerate() {
                *value += rows.iter().map(|row| row[i] * row[j]).sum::<f64>();
            }
        }
    }
    if count < 2 {
        return None;
    }
    let variance = keypoint_deviation(landmark.error, landmark.images.len()).powi(2);
    let [a, b, c] = information;
    // The inverse of a symmetric matrix, by Cramer's rule.
    let cofactors = [cross(b, c), cross(c, a), cross(a, b)];
    let scale = variance / dot(a, cofactors[0]);
    (scale > 0.0 && scale.is_finite()).then(|| cofactors.map(|row| row.map(|v| scale * v)))
}

/// Returns the standard deviation of a point along the optical axis of an image, a vector of length 1, at most its `depth`.
/// `None` if the covariance tells that the rays to the point are parallel up to rounding.
pub(super) fn depth_deviation(covariance: &Covariance, axis: [f64; 3], depth: f64) -> Option<f64> {
    /// Relative to the depth. With 0.3 pixels, it is reached at a disparity of 0.0004 pixels.
    const PARALLEL: f64 = 1e3;
    let deviation = dot(axis, covariance.map(|row| dot(row, axis))).sqrt();
    (deviation > 0.0 && deviation < PARALLEL * depth).then(|| deviation.min(depth))
}

/// Returns the rows of the Jacobian of the pixel of a point, in pixels per unit of the world, and its depth; `None` for points
/// that the camera does not see.
fn jacobian(camera: &Camera, position: [f64; 3]) -> Option<([[f64; 3]; 2], f64)> {
    /// Relative to the depth: derivatives have a relative error of about its square.
    const STEP: f64 = 1e-5;
    let (_, depth) = camera.project(position)?;
    let step = STEP * depth;
    let mut rows = [[0.0; 3]; 2];
    for i in 0..3 {
        let moved = |by: f64| {
            let mut moved = position;
            moved[i] += by;
            camera.project(moved)
        };
        let ((ahead, _), (behind, _)) = (moved(step)?, moved(-step)?);
        for (row, (a, b)) in rows.iter_mut().zip(ahead.into_iter().zip(behind)) {
            row[i] = (a - b) / (2.0 * step);
        }
    }
    let finite = rows.iter().flatten().all(|v| v.is_finite());
    finite.then_some((rows, depth))
}

/// Returns the standard deviation of keypoints along each axis in pixels. `error` is the mean reprojection error of a point in
/// `count` images. The length of a normal 2D error with standard deviation s has the mean s sqrt(pi / 2), and the position takes
/// three of the 2 `count` degrees of freedom.
fn keypoint_deviation(error: f64, count: usize) -> f64 {
    /// Lower bound: no corner is located more precisely.
    const LEAST: f64 = 0.3;
    /// Models with an error of -1 do not have it.
    const UNKNOWN: f64 = 1.0;
    if error < 0.0 {
        return UNKNOWN;
    }
    let errors = 2.0 * count as f64;
    (error * (2.0 / std::f64::consts::PI * errors / (errors - 3.0)).sqrt()).max(LEAST)
}

#[cfg(test)]
mod tests {
    use super::*;

    const AXIS: [f64; 3] = [0.0, 0.0, 1.0];
    const UPRIGHT: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], AXIS];

    /// The deviation of a point with this reprojection error between two cameras, whose centres are `baseline` apart.
    fn of_two(position: [f64; 3], baseline: f64, error: f64) -> Option<f64> {
        let camera = |x: f64| {
            let camera = Camera::pinhole([500.0; 2], [320.0, 240.0]);
            camera.with_pose(UPRIGHT, [-x, 0.0, 0.0])
        };
        let cameras = HashMap::from([(1, camera(-baseline / 2.0)), (2, camera(baseline / 2.0))]);
        let landmark = Landmark {
            position,
            error,
            images: vec![1, 2],
        };
        depth_deviation(&covariance(&landmark, &cameras)?, AXIS, position[2])
    }

    #[test]
    fn two_images_are_as_precise_as_a_stereo_camera() {
        // A disparity d = f B / z with the deviation sqrt(2) s changes the depth by z^2 sqrt(2) s / (f B), anywhere in the
        // image.
        for (x, y, depth) in [(0.0, 0.0, 5.0), (8.0, -3.0, 20.0), (-80.0, 20.0, 80.0)] {
            let stereo = depth * depth * 2.0_f64.sqrt() * 0.3 / (500.0 * 0.4);
            let found = of_two([x, y, depth], 0.4, 0.1).unwrap();
            assert!(
                (found / stereo - 1.0).abs() < 1e-4,
                "{depth}: {found} {stereo}"
            );
        }
        // 1 pixel on average, of which one of four degrees of freedom is left.
        let at = [0.0, 0.0, 20.0];
        let wide = of_two(at, 0.4, 1.0).unwrap() / of_two(at, 0.4, 0.1).unwrap();
        let expected = (2.0 / std::f64::consts::PI * 4.0).sqrt() / 0.3;
        assert!((wide / expected - 1.0).abs() < 1e-9, "{wide} {expected}");
    }

    #[test]
    fn deviations_are_at_most_the_depth_and_unknown_for_parallel_rays() {
        // A disparity of 0.025 pixels.
        assert_eq!(of_two([0.0, 0.0, 20.0], 1e-3, 0.1), Some(20.0));
        assert_eq!(of_two([1.0, 2.0, 20.0], 0.0, 0.1), None);
        let landmark = Landmark {
            position: AXIS,
            error: 0.5,
            images: vec![7, 7],
        };
        let cameras = HashMap::from([(7, Camera::pinhole([500.0; 2], [320.0, 240.0]))]);
        assert_eq!(covariance(&landmark, &cameras), None);
    }

    #[test]
    fn errors_that_a_model_does_not_have_are_a_pixel() {
        assert_eq!(keypoint_deviation(-1.0, 2), 1.0);
        assert_eq!(keypoint_deviation(0.0, 9), 0.3);
    }
}
