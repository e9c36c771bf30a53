//! Cameras as stored in files, and their validation.

use super::Camera;
use crate::pose::Pose;
use lsdc_core::Lens;
use serde::Deserialize;

/// A camera as stored in a file.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CameraFile {
    pub(super) width: Option<usize>,
    pub(super) height: Option<usize>,
    pub(super) fx: Option<f64>,
    pub(super) fy: Option<f64>,
    pub(super) cx: Option<f64>,
    pub(super) cy: Option<f64>,
    pub(super) intrinsic_matrix: Option<[f64; 9]>,
    #[serde(default)]
    pub(super) model: LensModel,
    #[serde(default)]
    pub(super) distortion: Vec<f64>,
    pub(super) world_to_camera: Option<Vec<[f64; 4]>>,
    pub(super) camera_to_world: Option<Vec<[f64; 4]>>,
    #[serde(skip)]
    pub(super) assumed: Vec<String>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum LensModel {
    #[default]
    Pinhole,
    Radtan,
    Fisheye,
}

impl CameraFile {
    pub(super) fn pinhole([fx, fy, cx, cy]: [f64; 4]) -> Self {
        Self {
            fx: Some(fx),
            fy: Some(fy),
            cx: Some(cx),
            cy: Some(cy),
            ..Self::default()
        }
    }
}

impl TryFrom<CameraFile> for Camera {
    type Error = String;

    fn try_from(stored: CameraFile) -> Result<Self, String> {
        let numbers = [stored.fx, stored.fy, stored.cx, stored.cy];
        let [fx, fy, cx, cy] = match (numbers, stored.intrinsic_matrix) {
            ([Some(fx), Some(fy), Some(cx), Some(cy)], None) => [fx, fy, cx, cy],
            ([None, None, None, None], Some(m)) => {
                intrinsics([[m[0], m[3], m[6]], [m[1], m[4], m[7]], [m[2], m[5], m[8]]])
                    .map_err(|what| format!("has an intrinsic_matrix, column by column, {what}"))?
            }
            _ => return Err("needs fx, fy, cx and cy, or an intrinsic_matrix".to_owned()),
        };
        let is_valid = fx > 0.0 && fy > 0.0 && [fx, fy, cx, cy].iter().all(|v| v.is_finite());
        if !is_valid {
            return Err(format!("cannot have fx {fx}, fy {fy}, cx {cx}, cy {cy}"));
        }
        let mut camera = Self::pinhole([fx, fy], [cx, cy]);
        camera.assumed = stored.assumed;
        camera.size = match (stored.width, stored.height) {
            (Some(width), Some(height)) if width > 0 && height > 0 => Some((width, height)),
            (None, None) => None,
            _ => return Err("needs both width and height, or neither".to_owned()),
        };
        let camera = camera.with_lens(stored.model.lens(&stored.distortion)?);
        let pose = match (stored.world_to_camera, stored.camera_to_world) {
            (None, None) => return Ok(camera),
            (Some(rows), None) => Pose::of_rows(&rows)?,
            (None, Some(rows)) => Pose::of_rows(&rows)?.inverse(),
            (Some(_), Some(_)) => {
                return Err("has both world_to_camera and camera_to_world".to_owned());
            }
        };
        Ok(camera.with_pose(pose.rotation, pose.translation))
    }
}

/// Returns fx, fy, cx and cy of a matrix row by row.
pub(super) fn intrinsics(rows: [[f64; 3]; 3]) -> Result<[f64; 4], String> {
    let [[fx, skew, cx], [a, fy, cy], last] = rows;
    if rows.iter().flatten().all(|&v| v == 0.0) {
        return Err("of zeros: the camera is not calibrated".to_owned());
    }
    if a != 0.0 || last != [0.0, 0.0, 1.0] {
        return Err("that is no camera matrix; is it transposed?".to_owned());
    }
    if skew.abs() > SKEW * fx.abs() {
        return Err(format!("with a skew of {skew}, which is not supported"));
    }
    Ok([fx, fy, cx, cy])
}

/// Largest skew as a share of the focal length; it moves no pixel by a tenth.
const SKEW: f64 = 1e-4;

impl LensModel {
    fn lens(self, distortion: &[f64]) -> Result<Lens, String> {
        let few = |counts: &str| {
            let found = distortion.len();
            Err(format!(
                "has {found} distortion coefficients, {self:?} takes {counts}"
            ))
        };
        if let Some(bad) = distortion.iter().find(|v| !v.is_finite()) {
            return Err(format!("cannot have a distortion of {bad}"));
        }
        match (self, distortion.len()) {
            (Self::Pinhole, 0) => Ok(Lens::Pinhole),
            (Self::Pinhole, _) => few("none; say model radtan or fisheye"),
            (Self::Radtan, 4 | 5 | 8) => {
                let mut coefficients = [0.0; 8];
                coefficients[..distortion.len()].copy_from_slice(distortion);
                Ok(Lens::radial_tangential(coefficients))
            }
            (Self::Radtan, _) => few("4, 5 or 8: k1, k2, p1, p2, k3, k4, k5, k6"),
            (Self::Fisheye, _) => match *distortion {
                [k1, k2, k3, k4] => Ok(Lens::fisheye([k1, k2, k3, k4])),
                _ => few("4: k1 to k4"),
            },
        }
    }
}
