//! `transforms.json`, as written by nerfstudio, Instant NGP, `NeRF` and apps for `ARKit`.

use super::keys::Keys;
use super::text::{NoPose, matrix};
use super::{PosedFrame, Poses};
use crate::Camera;
use crate::error::{Error, Result};
use crate::pose::Pose;
use lsdc_core::Lens;
use serde::Deserialize;
use std::path::Path;

#[derive(Deserialize)]
struct Transforms {
    #[serde(flatten)]
    shared: Intrinsics,
    frames: Vec<Frame>,
}

#[derive(Deserialize)]
struct Frame {
    file_path: String,
    /// Rows of a 4x4 matrix; JSON has no number for values that are not finite.
    transform_matrix: Vec<Vec<Option<f64>>>,
    #[serde(flatten)]
    own: Intrinsics,
}

/// Intrinsics of a frame or of the file; those of a frame take precedence.
#[derive(Clone, Default, Deserialize)]
struct Intrinsics {
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    w: Option<f64>,
    h: Option<f64>,
    /// Horizontal field of view in radians.
    camera_angle_x: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
    camera_model: Option<String>,
    is_fisheye: Option<bool>,
}

pub(super) fn read(path: &Path) -> Result<Poses> {
    let text = std::fs::read_to_string(path).map_err(|e| Error::read(path, e))?;
    let file: Transforms = serde_json::from_str(&text).map_err(|e| {
        Error::format(path, "is no transforms.json")
            .because(e)
            .hint("it has `frames`, each with a file_path and a transform_matrix of 4x4 numbers")
    })?;
    let (mut names, mut frames, mut broken) = (Vec::new(), Vec::new(), Vec::new());
    for Frame {
        file_path,
        transform_matrix,
        own,
    } in file.frames
    {
        let pose = match pose(&transform_matrix) {
            Ok(pose) => pose,
            Err(NoPose::Broken(what)) => {
                broken.push(format!("`{file_path}`, {what}"));
                continue;
            }
            Err(NoPose::Unsound(what)) => {
                return Err(Error::format(path, format!("frame `{file_path}` {what}")));
            }
        };
        let camera = own
            .or(&file.shared)
            .camera()
            .map_err(|what| Error::format(path, format!("frame `{file_path}` {what}")))?;
        frames.push(PosedFrame {
            camera: camera.map(|camera| camera.with_pose(pose.rotation, pose.translation)),
            pose,
        });
        names.push(file_path);
    }
    let ignored = broken.len();
    Ok(Poses::new(
        Keys::names(names),
        frames,
        ignored,
        broken.into_iter().next(),
    ))
}

/// Converts the pose of a camera that looks along -z, from the camera to the world, to that of a camera that looks along z,
/// from the world to the camera.
fn pose(rows: &[Vec<Option<f64>>]) -> std::result::Result<Pose, NoPose> {
    let numbers: Option<Vec<f64>> = rows.iter().take(3).flatten().copied().collect();
    let numbers = numbers.ok_or(NoPose::Broken("holds a number that is not finite"))?;
    if numbers.len() != 12 || !matches!(rows.len(), 3 | 4) {
        return Err(NoPose::Broken("has no matrix of 3x4 or 4x4 numbers"));
    }
    let mut camera_to_world = matrix(&numbers)?;
    for row in &mut camera_to_world.rotation {
        row[1] = -row[1];
        row[2] = -row[2];
    }
    Ok(camera_to_world.inverse())
}

impl Intrinsics {
    fn or(self, other: &Self) -> Self {
        Self {
            fl_x: self.fl_x.or(other.fl_x),
            fl_y: self.fl_y.or(other.fl_y),
            cx: self.cx.or(other.cx),
            cy: self.cy.or(other.cy),
            w: self.w.or(other.w),
            h: self.h.or(other.h),
            camera_angle_x: self.camera_angle_x.or(other.camera_angle_x),
            k1: self.k1.or(other.k1),
            k2: self.k2.or(other.k2),
            k3: self.k3.or(other.k3),
            k4: self.k4.or(other.k4),
            p1: self.p1.or(other.p1),
            p2: self.p2.or(other.p2),
            camera_model: self.camera_model.or_else(|| other.camera_model.clone()),
            is_fisheye: self.is_fisheye.or(other.is_fisheye),
        }
    }

    /// Returns the camera at the origin, if its kind is supported and it is complete.
    ///
    /// # Errors
    /// The intrinsics are invalid.
    fn camera(&self) -> std::result::Result<Option<Camera>, String> {
        let of_angle = |angle: f64| Some(0.5 * self.w? / (0.5 * angle).tan());
        let angle = self.camera_angle_x.and_then(of_angle);
        let (Some(fx), Some(lens)) = (self.fl_x.or(angle), self.lens()) else {
            return Ok(None);
        };
        let fy = self.fl_y.unwrap_or(fx);
        let middle = |length: Option<f64>| length.map(|length| 0.5 * length);
        let center = [self.cx.or(middle(self.w)), self.cy.or(middle(self.h))];
        let [Some(cx), Some(cy)] = center else {
            return Ok(None);
        };
        // The centre of the first pixel is at 0.5.
        let optics = lsdc_core::Camera::pinhole([fx, fy], [cx - 0.5, cy - 0.5]).with_lens(lens);
        optics
            .check()
            .map_err(|error| format!("cannot be used: {error}"))?;
        let size = match (self.w, self.h) {
            (Some(w), Some(h)) if w >= 1.0 && h >= 1.0 => Some((w as usize, h as usize)),
            _ => None,
        };
        Ok(Some(Camera::new(optics, size)))
    }

    fn lens(&self) -> Option<Lens> {
        let [k1, k2, k3, k4, p1, p2] =
            [self.k1, self.k2, self.k3, self.k4, self.p1, self.p2].map(Option::unwrap_or_default);
        let fisheye = self.is_fisheye == Some(true);
        match self.camera_model.as_deref() {
            Some("OPENCV_FISHEYE") => Some(Lens::fisheye([k1, k2, k3, k4])),
            None if fisheye => Some(Lens::fisheye([k1, k2, k3, k4])),
            Some("PINHOLE" | "SIMPLE_PINHOLE") => Some(Lens::Pinhole),
            None | Some("OPENCV" | "RADIAL" | "SIMPLE_RADIAL") => {
                let coefficients = [k1, k2, p1, p2, k3, 0.0, 0.0, 0.0];
                Some(if coefficients == [0.0; 8] {
                    Lens::Pinhole
                } else {
                    Lens::radial_tangential(coefficients)
                })
            }
            Some(_) => None,
        }
    }
}
