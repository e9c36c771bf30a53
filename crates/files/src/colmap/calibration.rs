//! The camera models of COLMAP (`src/colmap/sensor/models.h`).

use super::records::Parsed;
use crate::Camera;
use lsdc_core::Lens;

/// What a file says of a camera.
pub(super) struct Calibration {
    pub(super) size: (u64, u64),
    /// In pixels.
    pub(super) focal: f64,
    /// `None` for the models of fields of view, thin prisms, divisions and EUCM.
    pub(super) camera: Option<Camera>,
}

/// Names and numbers of parameters, in the order of the models' numbers.
const MODELS: [(&str, usize); 18] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    // From COLMAP 4 on.
    ("SIMPLE_DIVISION", 4),
    ("DIVISION", 5),
    ("SIMPLE_FISHEYE", 3),
    ("FISHEYE", 4),
    ("EUCM", 6),
    (EVERYWHERE, 2),
];

/// What looks all around has no axis that depths could be measured along.
const EVERYWHERE: &str = "EQUIRECTANGULAR";

/// Name and number of parameters of the model of that number.
pub(super) fn model(number: u32) -> Option<(&'static str, usize)> {
    MODELS.get(number as usize).copied()
}

impl Calibration {
    pub(super) fn new(model: &str, size: (u64, u64), parameters: &[f64]) -> Parsed<Self> {
        let pinhole = |fx: f64, fy: f64, cx: f64, cy: f64| {
            // COLMAP has the centre of the first pixel at 0.5.
            Camera::pinhole([fx, fy], [cx - 0.5, cy - 0.5])
        };
        let radtan =
            |k1: f64, k2: f64| Lens::radial_tangential([k1, k2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let camera = match (model, parameters) {
            ("SIMPLE_PINHOLE", &[f, cx, cy]) => Some(pinhole(f, f, cx, cy)),
            ("PINHOLE", &[fx, fy, cx, cy]) => Some(pinhole(fx, fy, cx, cy)),
            ("SIMPLE_RADIAL", &[f, cx, cy, k]) => {
                Some(pinhole(f, f, cx, cy).with_lens(radtan(k, 0.0)))
            }
            ("RADIAL", &[f, cx, cy, k1, k2]) => {
                Some(pinhole(f, f, cx, cy).with_lens(radtan(k1, k2)))
            }
            ("OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2]) => {
                let lens = Lens::radial_tangential([k1, k2, p1, p2, 0.0, 0.0, 0.0, 0.0]);
                Some(pinhole(fx, fy, cx, cy).with_lens(lens))
            }
            ("FULL_OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6]) => {
                let lens = Lens::radial_tangential([k1, k2, p1, p2, k3, k4, k5, k6]);
                Some(pinhole(fx, fy, cx, cy).with_lens(lens))
            }
            ("OPENCV_FISHEYE", &[fx, fy, cx, cy, k1, k2, k3, k4]) => {
                Some(pinhole(fx, fy, cx, cy).with_lens(Lens::fisheye([k1, k2, k3, k4])))
            }
            ("SIMPLE_FISHEYE", &[f, cx, cy]) => {
                Some(pinhole(f, f, cx, cy).with_lens(Lens::fisheye([0.0; 4])))
            }
            ("FISHEYE", &[fx, fy, cx, cy]) => {
                Some(pinhole(fx, fy, cx, cy).with_lens(Lens::fisheye([0.0; 4])))
            }
            ("SIMPLE_RADIAL_FISHEYE", &[f, cx, cy, k]) => {
                Some(pinhole(f, f, cx, cy).with_lens(Lens::fisheye([k, 0.0, 0.0, 0.0])))
            }
            ("RADIAL_FISHEYE", &[f, cx, cy, k1, k2]) => {
                Some(pinhole(f, f, cx, cy).with_lens(Lens::fisheye([k1, k2, 0.0, 0.0])))
            }
            _ => None,
        };
        let expected = MODELS.iter().find(|(name, _)| *name == model);
        match (expected, parameters) {
            _ if model == EVERYWHERE => Err(format!(
                "a camera {model} looks all around, so that there are no depths along its axis"
            )),
            (Some((_, count)), _) if *count != parameters.len() => Err(format!(
                "a camera {model} has {} parameters, expected {count}",
                parameters.len()
            )),
            (_, [focal, ..]) if *focal > 0.0 && focal.is_finite() => Ok(Self {
                size,
                focal: camera.as_ref().map_or(*focal, Camera::focal),
                camera,
            }),
            _ => Err(format!("a camera {model} has no focal length")),
        }
    }
}
