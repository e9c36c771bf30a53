//! Errors of the camera poses given to methods.

use lsdc_core::Camera;
use lsdc_files::error::{Error, Result};
use lsdc_files::rotation_matrix;
use lsdc_rng::Rng;
use std::fmt::{Display, Formatter};
use std::str::FromStr;

/// Error of the poses given to a method.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PoseError {
    /// True poses.
    Exact,
    /// Each camera is shifted by this distance and rotated by this angle about its centre, in random directions independent of
    /// other frames.
    Off {
        /// Distance in metres.
        distance: f64,
        /// Angle in degrees.
        angle: f64,
    },
    /// Each frame gets the pose of another random frame.
    Shuffled,
}

impl PoseError {
    /// Returns the cameras with errors; a seed gives the same result on every machine.
    pub fn apply(self, cameras: &[Camera], seed: u64) -> Vec<Camera> {
        let mut rng = Rng::stream(seed, &["pose error"]);
        match self {
            Self::Exact => cameras.to_vec(),
            Self::Off { distance, angle } => cameras
                .iter()
                .map(|camera| moved(camera, distance, angle.to_radians(), &mut rng))
                .collect(),
            Self::Shuffled => {
                let mut order: Vec<usize> = (0..cameras.len()).collect();
                // Sattolo's algorithm: no frame keeps its own pose.
                for i in (1..order.len()).rev() {
                    order.swap(i, rng.below(i as u32) as usize);
                }
                let pairs = cameras.iter().zip(order);
                pairs
                    .map(|(camera, other)| {
                        let (rotation, translation) = cameras[other].pose();
                        camera.clone().with_pose(rotation, translation)
                    })
                    .collect()
            }
        }
    }
}

/// Shifts a camera, and rotates it about its centre, in random directions.
fn moved(camera: &Camera, distance: f64, angle: f64, rng: &mut Rng) -> Camera {
    let (rotation, translation) = camera.pose();
    let shift = direction(rng).map(|v| v * distance);
    let (sin, cos) = (angle / 2.0).sin_cos();
    let [x, y, z] = direction(rng).map(|v| v * sin);
    let turn = rotation_matrix([x, y, z, cos]);
    let times = |vector: [f64; 3]| turn.map(|row| dot(row, vector));
    let columns = [0, 1, 2].map(|j| times(rotation.map(|row| row[j])));
    let turned = [0, 1, 2].map(|i| columns.map(|column| column[i]));
    // In camera coordinates, a shift of the centre moves points the opposite way.
    let moved = [0, 1, 2].map(|i| translation[i] - shift[i]);
    camera.clone().with_pose(turned, times(moved))
}

/// Returns a random unit vector, uniform on the sphere.
fn direction(rng: &mut Rng) -> [f64; 3] {
    loop {
        let vector = [(); 3].map(|()| f64::from(rng.normal()));
        let length = dot(vector, vector).sqrt();
        if length > 0.0 {
            return vector.map(|v| v / length);
        }
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

impl Display for PoseError {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Exact => write!(f, "exact"),
            Self::Off { distance, angle } => write!(f, "off:{distance}:{angle}"),
            Self::Shuffled => write!(f, "shuffled"),
        }
    }
}

impl FromStr for PoseError {
    type Err = Error;

    /// Parses `exact`, `off:METRES:DEGREES` or `shuffled`.
    fn from_str(text: &str) -> Result<Self> {
        let number = |text: &str| {
            text.parse()
                .ok()
                .filter(|v: &f64| *v >= 0.0 && v.is_finite())
        };
        let off = |text: &str| {
            let (distance, angle) = text.strip_prefix("off:")?.split_once(':')?;
            Some(Self::Off {
                distance: number(distance)?,
                angle: number(angle)?,
            })
        };
        match text {
            "exact" => Ok(Self::Exact),
            "shuffled" => Ok(Self::Shuffled),
            _ => off(text).ok_or_else(|| {
                Error::config(format!("`{text}` is no error of poses"))
                    .hint("exact, off:METRES:DEGREES, shuffled")
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cameras() -> Vec<Camera> {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let turn = rotation_matrix([0.0, half, 0.0, half]);
        (0..5)
            .map(|i| {
                let place = [f64::from(i), 0.5, -1.0];
                Camera::pinhole([100.0; 2], [31.5, 23.5]).with_pose(turn, place)
            })
            .collect()
    }

    fn center(camera: &Camera) -> [f64; 3] {
        // The point at depth 0.
        camera.unproject([0.0, 0.0], 0.0).unwrap()
    }

    #[test]
    fn cameras_are_off_by_the_distance_and_the_angle() {
        let (distance, angle) = (0.2, 5.0);
        let cameras = cameras();
        let off = PoseError::Off { distance, angle }.apply(&cameras, 3);
        for (camera, off) in cameras.iter().zip(&off) {
            off.check().unwrap();
            let [a, b] = [camera, off].map(center);
            let difference = [0, 1, 2].map(|i| a[i] - b[i]);
            assert!((dot(difference, difference).sqrt() - distance).abs() < 1e-9);
            // The trace of A B^T is 1 + 2 cos(angle).
            let ([a, _], [b, _]) = ([camera.pose(); 2], [off.pose(); 2]);
            let trace: f64 = (0..3).map(|i| dot(a.0[i], b.0[i])).sum();
            let found = ((trace - 1.0) / 2.0).acos().to_degrees();
            assert!((found - angle).abs() < 1e-6, "{found}");
        }
        assert_ne!(off, PoseError::Off { distance, angle }.apply(&cameras, 4));
    }

    #[test]
    fn shuffled_frames_have_poses_of_others_each_once() {
        let cameras = cameras();
        for seed in 0..20 {
            let shuffled = PoseError::Shuffled.apply(&cameras, seed);
            let places: std::collections::BTreeSet<i64> = shuffled
                .iter()
                .map(|camera| camera.pose().1[0] as i64)
                .collect();
            assert_eq!(places.len(), 5);
            assert!(shuffled.iter().zip(&cameras).all(|(a, b)| a != b));
        }
        assert_eq!(PoseError::Exact.apply(&cameras, 0), cameras);
    }

    #[test]
    fn texts_are_read_as_written() {
        for text in ["exact", "off:0.01:0.3", "shuffled"] {
            assert_eq!(text.parse::<PoseError>().unwrap().to_string(), text);
        }
        for wrong in ["", "off:1", "off:-1:0", "off:nan:0", "near"] {
            assert!(wrong.parse::<PoseError>().is_err(), "{wrong}");
        }
    }
}
