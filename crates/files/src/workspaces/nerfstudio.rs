//! The `transforms.json` of nerfstudio, and its depth maps.
//!
//! Its loader multiplies depths by `depth_unit_scale_factor`, 0.001 by default, for 16-bit PNG and for npy alike
//! (`get_depth_image_from_path`), so depths are stored in thousandths of the unit of the model. 0 means no depth.
//!
//! Depths are along the optical axis, except for fisheye lenses. nerfstudio compares depths times `directions_norm` with
//! distances along its rays: the length of (x, y, 1) for perspective cameras, but 1 for fisheye ones
//! (`Cameras._generate_rays_from_coords`).

use crate::camera::Camera;
use crate::depth_kind::length_of_ray;
use crate::error::Result;
use crate::files::{encode_depth_png, encode_npy, raised_in_png};
use crate::pose::Pose;
use lsdc_core::{DepthMap, Lens};
use serde::Serialize;
use serde_json::json;
use std::collections::HashSet;
use std::path::PathBuf;

pub(super) const FOLDER: &str = "depths";

pub(super) const TRANSFORMS: &str = "transforms.json";

/// Reciprocal of `depth_unit_scale_factor`.
const PER_UNIT: f64 = 1000.0;

/// Farthest depth in a PNG.
const LARGEST: f32 = (u16::MAX as f64 / PER_UNIT) as f32;

/// Storage format of the depths of all images.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum DepthFormat {
    /// Thousandths as 16-bit integers.
    Png,
    /// Thousandths as 32-bit floats.
    Npy,
}

impl DepthFormat {
    /// Chooses PNG if its resolution suits the depths of a model: points are at least 0.5 units away, and four times the
    /// farthest depth fits in 16 bits. Models have an arbitrary scale, so many need floats.
    pub(super) fn of_range(range: Option<[f64; 2]>) -> Self {
        const NEAREST: f64 = 0.5;
        const MARGIN: f64 = 4.0;
        match range {
            Some([nearest, farthest])
                if nearest >= NEAREST && MARGIN * farthest <= f64::from(LARGEST) =>
            {
                Self::Png
            }
            _ => Self::Npy,
        }
    }

    pub(super) fn ending(self) -> &'static str {
        match self {
            Self::Png => ".png",
            Self::Npy => ".npy",
        }
    }

    /// Encodes a depth map. Also returns how many pixels are nearer than half a step of a PNG, and farther than it can
    /// store; they are clamped to the nearest and the farthest depth.
    pub(super) fn encode(self, depth: &DepthMap) -> Result<(Vec<u8>, [usize; 2])> {
        let (width, height) = (depth.width(), depth.height());
        let values = depth.values().iter();
        match self {
            Self::Png => {
                let step = PER_UNIT.recip();
                let farthest = values.clone().filter(|v| **v > LARGEST);
                let counts = [raised_in_png(depth, step), farthest.count()];
                let held = values.map(|v| v.min(LARGEST)).collect();
                let held = DepthMap::new(width, height, held)?;
                Ok((encode_depth_png(&held, step)?, counts))
            }
            Self::Npy => {
                let scaled = values.map(|v| v * PER_UNIT as f32).collect();
                let scaled = DepthMap::new(width, height, scaled)?;
                Ok((encode_npy(&scaled)?, [0, 0]))
            }
        }
    }
}

/// Whether nerfstudio supports the distortion of a lens: it has no rational radial distortion (k4 to k6 of `OpenCV`).
pub(super) fn is_usable(lens: &Lens) -> bool {
    match lens {
        Lens::Pinhole | Lens::Fisheye { .. } => true,
        Lens::Radtan { coefficients, .. } => coefficients[5..].iter().all(|k| *k == 0.0),
        _ => false,
    }
}

/// Returns the distances along the rays of a fisheye lens; `None` for other lenses, which keep depths along the axis.
/// Pixels without a ray have no depth.
pub(super) fn along_rays(depth: &DepthMap, camera: &Camera) -> Result<Option<DepthMap>> {
    if !matches!(camera.optics().lens(), Lens::Fisheye { .. }) {
        return Ok(None);
    }
    let (width, height) = (depth.width(), depth.height());
    let camera = camera.stretched((width, height));
    let mut values = vec![0.0; width * height];
    for point in depth.points() {
        let length = length_of_ray([point.x as f64, point.y as f64], &camera);
        let distance = length.map_or(0.0, |length| f64::from(point.depth) * length);
        values[point.y * width + point.x] = distance as f32;
    }
    Ok(Some(DepthMap::new(width, height, values)?))
}

/// Whether there are both fisheye and other lenses: nerfstudio has one lens model for all images.
pub(super) fn is_mixed<'a>(lenses: impl Iterator<Item = &'a Lens>) -> bool {
    let kinds: HashSet<bool> = lenses
        .map(|lens| matches!(lens, Lens::Fisheye { .. }))
        .collect();
    kinds.len() > 1
}

/// An image with its depth; paths are relative to the folder of the workspace.
pub(super) struct Image<'a> {
    pub(super) file: String,
    pub(super) depth: PathBuf,
    pub(super) size: (usize, usize),
    pub(super) camera: &'a Camera,
}

/// A frame of `transforms.json`.
#[derive(Serialize)]
struct Frame {
    file_path: String,
    depth_file_path: PathBuf,
    w: usize,
    h: usize,
    fl_x: f64,
    fl_y: f64,
    cx: f64,
    cy: f64,
    k1: f64,
    k2: f64,
    k3: f64,
    k4: f64,
    p1: f64,
    p2: f64,
    transform_matrix: [[f64; 4]; 4],
}

/// Returns `transforms.json`: camera poses in the world of the model, with the axes of OpenGL (x to the right, y up, z
/// backwards).
pub(super) fn transforms<'a>(images: impl Iterator<Item = Image<'a>>) -> String {
    let mut is_fisheye = false;
    let frames: Vec<Frame> = images
        .map(|image| {
            is_fisheye |= matches!(image.camera.optics().lens(), Lens::Fisheye { .. });
            frame(image)
        })
        .collect();
    // nerfstudio reads the camera model only here, for all frames.
    let camera_model = if is_fisheye {
        "OPENCV_FISHEYE"
    } else {
        "OPENCV"
    };
    let contents = json!({"camera_model": camera_model, "frames": frames});
    format!("{contents:#}\n")
}

fn frame(image: Image<'_>) -> Frame {
    let optics = image.camera.optics();
    let ([fl_x, fl_y], [cx, cy]) = (optics.focal(), optics.center());
    let [k1, k2, k3, k4, p1, p2] = match *optics.lens() {
        Lens::Radtan {
            coefficients: [k1, k2, p1, p2, k3, ..],
            ..
        } => [k1, k2, k3, 0.0, p1, p2],
        Lens::Fisheye {
            coefficients: [k1, k2, k3, k4],
            ..
        } => [k1, k2, k3, k4, 0.0, 0.0],
        _ => [0.0; 6],
    };
    Frame {
        file_path: image.file,
        depth_file_path: image.depth,
        w: image.size.0,
        h: image.size.1,
        fl_x,
        fl_y,
        // In nerfstudio the centre of the first pixel is at 0.5.
        cx: cx + 0.5,
        cy: cy + 0.5,
        k1,
        k2,
        k3,
        k4,
        p1,
        p2,
        transform_matrix: camera_to_world(optics),
    }
}

fn camera_to_world(camera: &lsdc_core::Camera) -> [[f64; 4]; 4] {
    let (rotation, translation) = camera.pose();
    let Pose {
        rotation,
        translation: centre,
    } = Pose {
        rotation,
        translation,
    }
    .inverse();
    let row = |i: usize| {
        let [x, y, z] = rotation[i];
        [x, -y, -z, centre[i]]
    };
    [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::Value;

    /// A camera at (1, 2, 3) that looks along the world's x axis; the world's z axis is up.
    #[test]
    fn frames_have_the_axes_of_opengl() {
        let rotation = [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]];
        // x of the camera is -y of the world, y is -z, z is x: t = -R c.
        let optics = lsdc_core::Camera::pinhole([500.0, 510.0], [319.5, 239.5])
            .with_lens(Lens::radial_tangential([
                0.1, 0.2, 0.3, 0.4, 0.5, 0.0, 0.0, 0.0,
            ]))
            .with_pose(rotation, [2.0, 3.0, -1.0]);
        let camera = Camera::new(optics, Some((640, 480)));
        let image = Image {
            file: "images/a.jpg".to_owned(),
            depth: "depths/a.jpg.png".into(),
            size: (640, 480),
            camera: &camera,
        };
        let text = transforms(std::iter::once(image));
        let found: Value = serde_json::from_str(&text).unwrap();
        assert_eq!(found["camera_model"], "OPENCV");
        let frame = &found["frames"][0];
        assert_eq!((&frame["cx"], &frame["cy"]), (&json!(320.0), &json!(240.0)));
        let names = ["fl_x", "fl_y", "k1", "k2", "p1", "p2", "k3", "k4"];
        let numbers = names.map(|name| frame[name].as_f64().unwrap());
        assert_eq!(numbers, [500.0, 510.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.0]);
        assert_eq!(frame["file_path"], "images/a.jpg");
        assert_eq!(frame["depth_file_path"], "depths/a.jpg.png");
        let matrix = &frame["transform_matrix"];
        let column = |j: usize| [0, 1, 2].map(|i| matrix[i][j].as_f64().unwrap());
        assert_eq!(column(0), [0.0, -1.0, 0.0], "right");
        assert_eq!(column(1), [0.0, 0.0, 1.0], "up");
        assert_eq!(column(2), [-1.0, 0.0, 0.0], "backwards");
        assert_eq!(column(3), [1.0, 2.0, 3.0], "centre");
    }

    #[test]
    fn arbitrary_scales_are_stored_as_floats() {
        for (range, format) in [
            (Some([0.8, 16.0]), DepthFormat::Png),
            (Some([0.8, 17.0]), DepthFormat::Npy),
            (Some([0.01, 0.2]), DepthFormat::Npy),
            (None, DepthFormat::Npy),
        ] {
            assert_eq!(DepthFormat::of_range(range), format, "{range:?}");
        }
    }

    /// The loader multiplies the values of both formats by 0.001.
    #[test]
    fn depths_beyond_a_png_are_counted() {
        let depths = vec![0.0, 0.0004, 2.0, 65.535, 66.0];
        let depth = DepthMap::new(5, 1, depths.clone()).unwrap();
        let (bytes, counts) = DepthFormat::Png.encode(&depth).unwrap();
        assert_eq!(counts, [1, 1]);
        let picture = image::load_from_memory(&bytes).unwrap().into_luma16();
        assert_eq!(picture.into_raw(), [0, 1, 2000, 65535, 65535]);
        let (bytes, counts) = DepthFormat::Npy.encode(&depth).unwrap();
        assert_eq!(counts, [0, 0]);
        let (floats, _) = bytes[bytes.len() - 20..].as_chunks::<4>();
        for (found, depth) in floats.iter().zip(depths) {
            let error = f32::from_le_bytes(*found) * 1e-3 - depth;
            assert!(error.abs() <= 1e-7 * depth, "{depth}: {error}");
        }
    }

    #[test]
    fn distortion_that_it_does_not_have_is_no_lens_of_it() {
        let lens = |k4| Lens::radial_tangential([0.1, 0.0, 0.0, 0.0, 0.2, k4, 0.0, 0.0]);
        assert!(is_usable(&lens(0.0)) && !is_usable(&lens(0.1)));
        let fisheye = Lens::fisheye([0.1, 0.2, 0.3, 0.4]);
        assert!(is_usable(&fisheye));
        assert!(is_mixed([&fisheye, &Lens::Pinhole].into_iter()));
        assert!(!is_mixed([&lens(0.0), &Lens::Pinhole].into_iter()));
    }
}
