//! Sparse models of COLMAP (Schönberger and Frahm 2016), text and binary: every image with the
//! points that it sees, at the depths that the model gives them.

mod binary;
mod calibration;
mod text;

use super::{Camera, Orientation, Unit};
use crate::error::{Error, Result};
use calibration::Calibration;
use std::collections::HashMap;
use std::io::ErrorKind;
use std::path::Path;

/// A model: its images by name.
#[derive(Clone, Debug)]
pub struct Colmap {
    /// In the order of their names.
    pub views: Vec<View>,
}

/// An image of a model.
#[derive(Clone, Debug)]
pub struct View {
    /// Its path below the folder of images.
    pub name: String,
    /// Width and height in pixels.
    pub size: (usize, usize),
    /// What it sees.
    keypoints: Vec<Keypoint>,
    /// Observations of points that the model does not have, or that lie behind the camera.
    pub ignored: usize,
    /// The camera at its place, in the unit of the model, if its kind is known.
    pub camera: Option<Camera>,
}

/// Where an image sees a point of the model.
#[derive(Clone, Copy, Debug)]
pub(super) struct Keypoint {
    /// From the centre of the first pixel, as stored.
    pub(super) u: f64,
    pub(super) v: f64,
    /// In the unit of the model, as its standard deviation.
    pub(super) depth: f64,
    pub(super) sigma: f64,
}

/// What a file says of an image.
struct Pose {
    /// w, x, y, z: from the world to the camera.
    rotation: [f64; 4],
    translation: [f64; 3],
    camera: u32,
    name: String,
    /// Place and point of each observation that has one.
    seen: Vec<([f64; 2], u64)>,
}

/// What a file says of a point.
struct Landmark {
    place: [f64; 3],
    /// Mean reprojection error in pixels.
    error: f64,
    /// Images that see it.
    track: usize,
}

/// The three files of a model.
struct Parts {
    cameras: HashMap<u32, Calibration>,
    poses: Vec<Pose>,
    landmarks: HashMap<u64, Landmark>,
}

/// What is wrong with a file, and where.
type Parsed<T> = std::result::Result<T, String>;

impl Colmap {
    /// Whether a folder holds a model.
    pub fn is_at(folder: &Path) -> bool {
        let forms = ["bin", "txt"].map(|ending| folder.join(format!("cameras.{ending}")));
        forms.iter().any(|path| path.exists())
    }

    /// Reads the folder that holds `cameras`, `images` and `points3D`, `.bin` or `.txt`.
    ///
    /// # Errors
    /// Files that are missing or damaged, an image of an unknown camera.
    pub fn read(folder: &Path) -> Result<Self> {
        Self::of_files(folder, |name| {
            let path = folder.join(name);
            match std::fs::read(&path) {
                Ok(bytes) => Ok(Some(bytes)),
                Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
                Err(error) => Err(Error::read(&path, error)),
            }
        })
    }

    /// A model whose files need not be on a disk: `file` gives the contents of that of a name, such as
    /// `cameras.bin`, if there is one. Messages name the folder.
    ///
    /// # Errors
    /// As [`Self::read`], and those of `file`.
    pub fn of_files<Bytes: AsRef<[u8]>>(
        folder: &Path,
        file: impl Fn(&str) -> Result<Option<Bytes>>,
    ) -> Result<Self> {
        let parts = Parts {
            cameras: part(folder, &file, "cameras", binary::cameras, text::cameras)?,
            poses: part(folder, &file, "images", binary::poses, text::poses)?,
            landmarks: part(
                folder,
                &file,
                "points3D",
                binary::landmarks,
                text::landmarks,
            )?,
        };
        let mut views = Vec::with_capacity(parts.poses.len());
        for pose in &parts.poses {
            views.push(parts.view(folder, pose)?);
        }
        views.sort_by(|a, b| a.name.cmp(&b.name));
        Ok(Self { views })
    }
}

impl View {
    /// The number of points that it sees.
    pub fn count(&self) -> usize {
        self.keypoints.len()
    }

    pub(super) fn keypoints(&self) -> &[Keypoint] {
        &self.keypoints
    }

    /// The camera of the image as it is shown, if its kind is known, in the unit of the model or in
    /// metres if that unit is given.
    ///
    /// # Errors
    /// An image of another shape than that of the model.
    pub fn camera_of(&self, image: &Orientation, unit: Option<Unit>) -> Result<Option<Camera>> {
        let camera = self.camera.as_ref();
        let camera = camera.map(|camera| camera.for_image(image)).transpose()?;
        let factor = unit.unwrap_or(Unit::MODEL).metres();
        Ok(camera.map(|(camera, _)| camera.in_unit(factor)))
    }
}

impl Parts {
    fn view(&self, folder: &Path, pose: &Pose) -> Result<View> {
        let camera = self.cameras.get(&pose.camera).ok_or_else(|| {
            Error::format(
                folder,
                format!("image `{}` has no camera {}", pose.name, pose.camera),
            )
        })?;
        let rotation = matrix(pose.rotation);
        let row = rotation[2];
        let mut keypoints = Vec::with_capacity(pose.seen.len());
        for ([u, v], point) in &pose.seen {
            let Some(landmark) = self.landmarks.get(point) else {
                continue;
            };
            let along = row.iter().zip(landmark.place).map(|(r, x)| r * x);
            let depth = along.sum::<f64>() + pose.translation[2];
            if depth > 0.0 && depth.is_finite() {
                keypoints.push(Keypoint {
                    // COLMAP has the centre of the first pixel at 0.5.
                    u: u - 0.5,
                    v: v - 0.5,
                    depth,
                    sigma: deviation(depth, landmark, camera.focal),
                });
            }
        }
        let size = [camera.size.0, camera.size.1].map(usize::try_from);
        let [Ok(width), Ok(height)] = size else {
            return Err(Error::format(folder, "a camera is implausibly large"));
        };
        Ok(View {
            name: pose.name.clone(),
            size: (width, height),
            camera: camera.camera.clone().map(|camera| {
                camera
                    .with_size((width, height))
                    .with_pose(rotation, pose.translation)
            }),
            ignored: pose.seen.len() - keypoints.len(),
            keypoints,
        })
    }
}

/// How far a depth is off, but for a factor that all have: a reprojection error of so many pixels,
/// seen from the distance, averaged over the images that see the point.
fn deviation(depth: f64, landmark: &Landmark, focal: f64) -> f64 {
    /// Errors below this are luck: no corner is found more exactly.
    const LEAST: f64 = 0.3;
    let error = landmark.error.max(LEAST);
    depth * error / (focal.max(1.0) * (landmark.track.max(2) as f64 - 1.0).sqrt())
}

/// The rotation of a unit quaternion w, x, y, z.
fn matrix(quaternion: [f64; 4]) -> [[f64; 3]; 3] {
    let norm = quaternion.iter().map(|v| v * v).sum::<f64>().sqrt();
    let [w, x, y, z] = quaternion.map(|v| v / norm.max(f64::MIN_POSITIVE));
    [
        [
            1.0 - 2.0 * (y * y + z * z),
            2.0 * (x * y - w * z),
            2.0 * (x * z + w * y),
        ],
        [
            2.0 * (x * y + w * z),
            1.0 - 2.0 * (x * x + z * z),
            2.0 * (y * z - w * x),
        ],
        [
            2.0 * (x * z - w * y),
            2.0 * (y * z + w * x),
            1.0 - 2.0 * (x * x + y * y),
        ],
    ]
}

/// Reads one file of a model, in the form in which it is there.
fn part<Bytes: AsRef<[u8]>, T>(
    folder: &Path,
    file: impl Fn(&str) -> Result<Option<Bytes>>,
    name: &str,
    binary: impl Fn(&[u8]) -> Parsed<T>,
    text: impl Fn(&str) -> Parsed<T>,
) -> Result<T> {
    let parsed = |name: &str, parsed: Parsed<T>| {
        parsed.map_err(|what| {
            Error::format(&folder.join(name), what)
                .hint("export the model again (`colmap model_converter`)")
        })
    };
    let (as_binary, as_text) = (format!("{name}.bin"), format!("{name}.txt"));
    if let Some(bytes) = file(&as_binary)? {
        return parsed(&as_binary, binary(bytes.as_ref()));
    }
    if let Some(bytes) = file(&as_text)? {
        let found = std::str::from_utf8(bytes.as_ref()).map_err(|_| "is no text".to_owned());
        return parsed(&as_text, found.and_then(text));
    }
    Err(
        Error::format(folder, format!("holds no {as_binary} or {as_text}"))
            .hint("a sparse model of COLMAP is a folder such as sparse/0"),
    )
}

#[cfg(test)]
mod tests;
