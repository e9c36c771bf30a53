//! Poses of the cameras of a sequence, as SLAM systems, datasets and `NeRF` programs write them.
//!
//! | what | a row or frame holds | found by |
//! |---|---|---|
//! | trajectory of TUM RGB-D | `timestamp tx ty tz qx qy qz qw`, camera to world | time |
//! | poses of the KITTI odometry benchmark | the 12 numbers of a 3x4 matrix, camera to world | row number |
//! | folder of 7-Scenes (`NAME.pose.txt`) or `ScanNet` (`NAME.txt`) | a 4x4 matrix, camera to world | name |
//! | `transforms.json` of nerfstudio, Instant NGP, `NeRF` and apps for `ARKit` | `transform_matrix`, 4x4, camera to world | name |
//! | sparse model of COLMAP | quaternion and translation, world to camera | name |
//!
//! Cameras look along z, with x to the right and y down, as [`lsdc_core::Camera`] does. Only those of `transforms.json`
//! look along -z with y up, as in OpenGL; their y and z axes are flipped. The axes of the world are kept.

mod keys;
mod text;
mod transforms;

use crate::error::{Error, Result};
use crate::files::has_ending;
use crate::pose::Pose;
use crate::{Camera, Colmap};
use keys::Keys;
use std::path::Path;

/// The poses of the cameras of a sequence.
///
/// ```no_run
/// # fn main() -> lsdc_files::error::Result<()> {
/// let poses = lsdc_files::Poses::open("groundtruth.txt".as_ref())?;
/// let camera = lsdc_core::Camera::pinhole([525.0, 525.0], [319.5, 239.5]);
/// if let Some(pose) = poses.of("rgb/1305031102.175304.png") {
///     let placed = camera.with_pose(pose.rotation, pose.translation);
///     let position = pose.inverse().translation;
/// }
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
pub struct Poses {
    keys: Keys,
    frames: Vec<PosedFrame>,
    ignored: usize,
    warnings: Vec<String>,
}

/// A frame: the pose of its camera, and the camera, if the file has it.
#[derive(Clone, Debug)]
struct PosedFrame {
    /// Pose from the world to the camera.
    pose: Pose,
    /// Camera at its pose.
    camera: Option<Camera>,
}

impl Poses {
    /// Reads a file or folder, whose kind is recognised by its contents.
    ///
    /// Rows and matrices without a valid pose (too few numbers, numbers that are not finite, a quaternion or matrix of
    /// zeros, a repeated time or name) are left out and counted. Quaternions are normalised.
    ///
    /// # Errors
    /// The file is missing, of an unknown kind, or without any pose; the length of a quaternion is not 1; or a matrix
    /// mirrors or scales.
    pub fn open(path: &Path) -> Result<Self> {
        let poses = if Colmap::is_at(path) {
            Self::of_model(Colmap::read(path)?)
        } else if path.is_dir() {
            text::read_folder(path)?
        } else if has_ending(path, "json") {
            transforms::read(path)?
        } else {
            text::read(path)?
        };
        if poses.frames.is_empty() {
            let what = match poses.ignored {
                0 => "holds no pose".to_owned(),
                ignored => format!("holds no pose: all {ignored} rows are broken"),
            };
            return Err(Error::format(path, what).hint(HINT));
        }
        Ok(poses)
    }

    /// Creates poses from frames and their keys. `ignored` poses could not be read; `first` describes the first of them.
    fn new(keys: Keys, frames: Vec<PosedFrame>, ignored: usize, first: Option<String>) -> Self {
        let total = frames.len() + ignored;
        let warnings = first.map(|first| {
            format!("{ignored} of {total} poses are left out; the first of them, {first}")
        });
        Self {
            keys,
            frames,
            ignored,
            warnings: warnings.into_iter().collect(),
        }
    }

    fn of_model(model: Colmap) -> Self {
        let (mut names, mut frames, mut unknown) = (Vec::new(), Vec::new(), Vec::new());
        for view in model.views {
            let Some(camera) = view.camera else {
                unknown.push(format!(
                    "`{}`, has a camera model that is not read",
                    view.name
                ));
                continue;
            };
            names.push(view.name);
            frames.push(PosedFrame::of_camera(camera));
        }
        let ignored = unknown.len();
        Self::new(
            Keys::names(names),
            frames,
            ignored,
            unknown.into_iter().next(),
        )
    }

    /// Returns the pose of a frame, from the world to the camera; its inverse is from the camera to the world.
    ///
    /// `name` is that of an image or a result, with or without folders and extensions. Names are compared with those of the
    /// file. If the file has times, the name is a time in seconds, or in milliseconds, microseconds or nanoseconds since
    /// 1970, and the nearest pose within [`Self::TIME_TOLERANCE`] is taken. If the file has only rows, the digits at the
    /// end of the name are the index of the row, from 0.
    pub fn of(&self, name: &str) -> Option<Pose> {
        self.frame(name).map(|frame| frame.pose)
    }

    /// Returns the camera of a frame at its pose, if the file has its intrinsics. It applies to the pixels as stored: see
    /// [`Camera::for_image`].
    pub fn camera(&self, name: &str) -> Option<&Camera> {
        self.frame(name)?.camera.as_ref()
    }

    fn frame(&self, name: &str) -> Option<&PosedFrame> {
        self.keys.find(name).map(|index| &self.frames[index])
    }

    /// Largest time between a frame and its pose in seconds, as in the tools of the TUM RGB-D benchmark.
    pub const TIME_TOLERANCE: f64 = 0.02;

    /// Returns the number of poses.
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// Whether there is no pose; [`Self::open`] returns at least one.
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// Returns the number of rows, matrices or frames without a valid pose, or with a repeated key.
    pub fn ignored(&self) -> usize {
        self.ignored
    }

    /// Returns warnings about omitted poses, a sentence each.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }
}

impl PosedFrame {
    fn of_camera(camera: Camera) -> Self {
        let (rotation, translation) = camera.optics().pose();
        Self {
            pose: Pose {
                rotation,
                translation,
            },
            camera: Some(camera),
        }
    }
}

const HINT: &str = "poses are a TUM trajectory (timestamp tx ty tz qx qy qz qw), KITTI rows of 12 numbers, a folder of \
                    4x4 matrices (NAME.pose.txt), a transforms.json or a COLMAP model";

#[cfg(test)]
mod tests;
