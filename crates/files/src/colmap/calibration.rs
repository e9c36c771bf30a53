//! The camera models of COLMAP (`src/colmap/sensor/models.h`).

use super::records::Parsed;
use crate::Camera;
use lsdc_core::Lens;

/// A record of `cameras`.
pub(super) struct CameraRecord {
    pub(super) size: (u64, u64),
    /// `None` for the field-of-view, thin-prism, division and EUCM models.
    pub(super) camera: Option<Camera>,
}

/// A camera model: its name and number of parameters and, if it is supported, the number of its focal lengths and its lens.
/// Parameters are the focal lengths, the principal point, and the distortion.
type CameraModel = (&'static str, usize, Option<(usize, fn(&[f64]) -> Lens)>);

/// Models by their identifiers.
const MODELS: [CameraModel; 18] = [
    ("SIMPLE_PINHOLE", 3, Some((1, pinhole))),
    ("PINHOLE", 4, Some((2, pinhole))),
    ("SIMPLE_RADIAL", 4, Some((1, radial_tangential))),
    ("RADIAL", 5, Some((1, radial_tangential))),
    ("OPENCV", 8, Some((2, radial_tangential))),
    ("OPENCV_FISHEYE", 8, Some((2, fisheye))),
    ("FULL_OPENCV", 12, Some((2, radial_tangential))),
    ("FOV", 5, None),
    ("SIMPLE_RADIAL_FISHEYE", 4, Some((1, fisheye))),
    ("RADIAL_FISHEYE", 5, Some((1, fisheye))),
    ("THIN_PRISM_FISHEYE", 12, None),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16, None),
    // Since COLMAP 4.
    ("SIMPLE_DIVISION", 4, None),
    ("DIVISION", 5, None),
    ("SIMPLE_FISHEYE", 3, Some((1, fisheye))),
    ("FISHEYE", 4, Some((2, fisheye))),
    ("EUCM", 6, None),
    (EQUIRECTANGULAR, 2, None),
];

/// Model without an optical axis, so that depths along the axis are undefined.
const EQUIRECTANGULAR: &str = "EQUIRECTANGULAR";

fn pinhole(_: &[f64]) -> Lens {
    Lens::Pinhole
}

/// Returns a lens of k1, k2, p1, p2, k3, k4, k5, k6.
fn radial_tangential(distortion: &[f64]) -> Lens {
    Lens::radial_tangential(padded(distortion))
}

/// Returns a lens of k1, k2, k3, k4.
fn fisheye(distortion: &[f64]) -> Lens {
    Lens::fisheye(padded(distortion))
}

/// Pads coefficients with zeros.
fn padded<const N: usize>(coefficients: &[f64]) -> [f64; N] {
    let mut all = [0.0; N];
    all[..coefficients.len()].copy_from_slice(coefficients);
    all
}

/// Returns the name and the number of parameters of a model by its identifier.
pub(super) fn model(number: u32) -> Option<(&'static str, usize)> {
    let (name, count, _) = MODELS.get(number as usize)?;
    Some((*name, *count))
}

impl CameraRecord {
    pub(super) fn new(model: &str, size: (u64, u64), parameters: &[f64]) -> Parsed<Self> {
        let known = MODELS.iter().find(|(name, ..)| *name == model);
        let camera = || {
            let (_, count, optics) = known?;
            let (focal_lengths, lens) = optics.filter(|_| *count == parameters.len())?;
            let (focal, others) = parameters.split_at(focal_lengths);
            let ([cx, cy], distortion) = others.split_first_chunk::<2>()?;
            // In COLMAP the centre of the first pixel is at 0.5.
            let center = [cx - 0.5, cy - 0.5];
            let camera = Camera::pinhole([focal[0], focal[focal_lengths - 1]], center);
            Some(camera.with_lens(lens(distortion)))
        };
        match (known, parameters) {
            _ if model == EQUIRECTANGULAR => Err(format!(
                "a camera {model} looks all around, so that there are no depths along its axis"
            )),
            (Some((_, count, _)), _) if *count != parameters.len() => Err(format!(
                "a camera {model} has {} parameters, expected {count}",
                parameters.len()
            )),
            (_, [focal, ..]) if *focal > 0.0 && focal.is_finite() => Ok(Self {
                size,
                camera: camera(),
            }),
            _ => Err(format!("a camera {model} has no focal length")),
        }
    }
}
