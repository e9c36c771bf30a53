//! Reads cameras from files, and from four numbers.

use super::stored::CameraFile;
use super::{Camera, ros};
use crate::error::{Error, Result};
use crate::files::has_ending;
use std::path::Path;
use std::str::FromStr;

impl Camera {
    /// Reads a camera from TOML or JSON: `fx, fy, cx, cy`, or `intrinsic_matrix` of 9 numbers column by column as `Open3D`
    /// writes it; `width, height`; `model` (`pinhole`, `radtan`, `fisheye`) with its `distortion`; `world_to_camera` or
    /// `camera_to_world`, 3 or 4 rows of 4 numbers. Or from YAML, the `camera_info` of ROS: the camera of the unrectified
    /// image.
    ///
    /// # Errors
    /// The file is missing or not a camera.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::read(path, e))?;
        let is = |ending: &str| has_ending(path, ending);
        let stored: CameraFile = if is("yaml") || is("yml") {
            ros::parse(&text).map_err(|what| Error::format(path, what))
        } else if is("json") {
            serde_json::from_str(&text).map_err(|e| Error::format(path, "is no camera").because(e))
        } else {
            toml::from_str(&text).map_err(|e| Error::format(path, "is no camera").because(e))
        }
        .map_err(|e| match foreign(&text) {
            Some(kind) => Error::format(path, format!("is {kind}, which is not read")),
            None => e,
        })
        .map_err(|e| e.hint("a camera is TOML or JSON with fx, fy, cx, cy, model and distortion, or the camera_info of ROS; see docs/guide.md"))?;
        Self::try_from(stored).map_err(|what| Error::format(path, what))
    }

    /// Parses `FX,FY,CX,CY`; `None` if the text is anything else.
    ///
    /// # Errors
    /// Focal lengths are not positive, or numbers are not finite.
    pub fn of_numbers(text: &str) -> Option<Result<Self>> {
        let [fx, fy, cx, cy] = numbers(text)?[..] else {
            return None;
        };
        let camera = Self::try_from(CameraFile::pinhole([fx, fy, cx, cy]));
        Some(camera.map_err(|what| Error::config(format!("`{text}` {what}"))))
    }
}

/// Parses a comma-separated list of numbers; `None` if it contains anything else.
fn numbers(text: &str) -> Option<Vec<f64>> {
    text.split(',').map(|n| n.trim().parse().ok()).collect()
}

impl FromStr for Camera {
    type Err = Error;

    /// Parses `FX,FY,CX,CY`, or reads the file at a path.
    fn from_str(text: &str) -> Result<Self> {
        if let Some(camera) = Self::of_numbers(text) {
            return camera;
        }
        let count = numbers(text).map_or(0, |numbers| numbers.len());
        if count > 1 && !Path::new(text).exists() {
            let what = format!("`{text}` has {count} numbers, but a camera four");
            return Err(Error::config(what).hint(
                "FX,FY,CX,CY in pixels: the focal lengths and the principal point; with distortion, give a file",
            ));
        }
        Self::read(Path::new(text))
    }
}

/// Calibrations of other programs, by a word that they contain.
const FOREIGN: [(&str, &str); 8] = [
    ("fl_x", "the transforms.json of nerfstudio or Instant NGP"),
    ("camera_angle_x", "the transforms.json of a NeRF"),
    ("distortion_coeffs", "a calibration of Kalibr"),
    ("<opencv_storage>", "XML of OpenCV"),
    (
        "PinholeCameraParameters",
        "a camera with its pose by Open3D",
    ),
    ("PinholeCameraTrajectory", "a trajectory of Open3D"),
    ("\"ppx\"", "the intrinsics of librealsense"),
    ("T_cam_imu", "a calibration of Kalibr"),
];

/// Returns the kind of an unsupported calibration, if it is known.
fn foreign(text: &str) -> Option<&'static str> {
    let found = FOREIGN.iter().find(|(word, _)| text.contains(word));
    found.map(|(_, kind)| *kind)
}
