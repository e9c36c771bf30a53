//! Sparse models of COLMAP (Schönberger and Frahm 2016), text and binary: the points that every image sees, with their
//! depths.

mod binary;
mod calibration;
mod records;
mod text;
mod triangulation;

use super::{Camera, Orientation, Unit};
use crate::error::{Error, Result};
use crate::pose::Pose;
use calibration::CameraRecord;
use records::{ImageRecord, Landmark, Parsed, RigFrames, Rigs};
use std::collections::HashMap;
use std::io::ErrorKind;
use std::path::Path;
use triangulation::{CENTRE, Covariance, covariance, depth_deviation};

/// A sparse model.
#[derive(Clone, Debug)]
pub struct Colmap {
    /// Images, by name.
    pub views: Vec<View>,
}

/// An image of a model.
#[derive(Clone, Debug)]
pub struct View {
    /// Path below the folder of images.
    pub name: String,
    /// Width and height in pixels.
    pub size: (usize, usize),
    /// Points that the image sees.
    keypoints: Vec<Keypoint>,
    /// Number of observations of points that are not in the model, or that are behind the camera or at its centre.
    pub ignored: usize,
    /// Camera at its pose, in the unit of the model, if its model is supported.
    pub camera: Option<Camera>,
    /// Contradictions between files of the model about the image, a sentence each.
    pub remarks: Vec<String>,
}

/// An observation of a point of the model.
#[derive(Clone, Copy, Debug)]
pub(super) struct Keypoint {
    /// Column and row from the centre of the first pixel, as stored.
    pub(super) u: f64,
    pub(super) v: f64,
    /// Depth in the unit of the model, and its standard deviation if it is known.
    pub(super) depth: f64,
    pub(super) sigma: Option<f64>,
    /// Identifier of the point.
    pub(super) id: u64,
}

/// The files of a model, except `images`.
struct ModelFiles {
    cameras: HashMap<u32, CameraRecord>,
    landmarks: HashMap<u64, Landmark>,
    /// Present since COLMAP 3.12.
    rigs: Option<Rigs>,
    frames: Option<RigFrames>,
}

impl Colmap {
    /// Whether a folder contains a model.
    pub fn is_at(folder: &Path) -> bool {
        let forms = ["bin", "txt"].map(|ending| folder.join(format!("cameras.{ending}")));
        forms.iter().any(|path| path.exists())
    }

    /// Returns the names of the files that a model may have, in both forms.
    pub(super) fn files() -> impl Iterator<Item = String> {
        let names = ["cameras", "images", "points3D", "rigs", "frames"];
        let forms = |name| [BINARY, TEXT].map(|form| format!("{name}.{form}"));
        names.into_iter().flat_map(forms)
    }

    /// Reads the folder of `cameras`, `images` and `points3D`, and since COLMAP 3.12 of `rigs` and `frames`: all `.bin` or
    /// all `.txt`. If both exist, `.bin` is read. The poses of frames and rigs override those of images, as in COLMAP.
    ///
    /// # Errors
    /// Files are missing or damaged, or an image has an unknown camera.
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

    /// Reads a model that need not be on disk: `file` returns the contents of a file by its name, such as `cameras.bin`, or
    /// `None`. Messages contain the folder.
    ///
    /// # Errors
    /// As [`Self::read`], and errors of `file`.
    pub fn of_files<Bytes: AsRef<[u8]>>(
        folder: &Path,
        file: impl Fn(&str) -> Result<Option<Bytes>>,
    ) -> Result<Self> {
        let [cameras, images, landmarks] = whole(folder, &file)?;
        let form = images.form;
        let optional = |name: &'static str| ModelFile::read(folder, name, form, &file);
        let files = ModelFiles {
            cameras: cameras.parse(binary::cameras, text::cameras)?,
            landmarks: landmarks.parse(binary::landmarks, text::landmarks)?,
            rigs: optional("rigs")?
                .map(|rigs| rigs.parse(binary::rigs, text::rigs))
                .transpose()?,
            frames: optional("frames")?
                .map(|frames| frames.parse(binary::frames, text::frames))
                .transpose()?,
        };
        let images = images.parse(binary::images, text::images)?;
        let text_poses = match form {
            BINARY => poses_in_text(ModelFile::read(folder, "images", TEXT, &file)?),
            _ => HashMap::new(),
        };
        let cameras = images.iter().filter_map(|image| files.posed_camera(image));
        let cameras = cameras.collect();
        let landmarks = files.landmarks.iter();
        let covariances =
            landmarks.filter_map(|(&id, landmark)| Some((id, covariance(landmark, &cameras)?)));
        let covariances = covariances.collect();
        let mut views = Vec::with_capacity(images.len());
        for image in images {
            let text_pose = text_poses.get(&image.name);
            views.push(files.view(folder, image, text_pose, &covariances)?);
        }
        views.sort_by(|a, b| a.name.cmp(&b.name));
        Ok(Self { views })
    }
}

impl View {
    /// Returns the number of points that the image sees.
    pub fn count(&self) -> usize {
        self.keypoints.len()
    }

    pub(super) fn keypoints(&self) -> &[Keypoint] {
        &self.keypoints
    }

    /// Returns the camera of the upright image, if its model is supported, in the unit of the model or, if that unit is
    /// given, in metres.
    ///
    /// # Errors
    /// The image has another shape than that of the model.
    pub fn camera_of(&self, image: &Orientation, unit: Option<Unit>) -> Result<Option<Camera>> {
        let camera = self.camera.as_ref();
        let camera = camera.map(|camera| camera.for_image(image)).transpose()?;
        let factor = unit.unwrap_or(Unit::MODEL).metres();
        Ok(camera.map(|(camera, _)| camera.in_unit(factor)))
    }
}

/// Tolerance for the comparison of poses, for rounding in files: radians, and relative to the largest coordinate.
const POSE_TOLERANCE: f64 = 1e-5;

impl ModelFiles {
    /// Returns the pose of an image, and remarks about poses that contradict it. Frames and rigs override the file of
    /// images; `text_pose` is the pose in the text form of the model, if it has both forms.
    fn pose(&self, image: &ImageRecord, text_pose: Option<&Pose>) -> (Pose, Vec<String>) {
        let mut remarks = Vec::new();
        let mut compare = |pose: Pose, used: &str, other: Pose, unused: &str| {
            let (angle, distance) = pose.difference(other);
            let scale = pose.translation.iter().fold(1.0_f64, |a, v| a.max(v.abs()));
            if angle > POSE_TOLERANCE.to_degrees() || distance > POSE_TOLERANCE * scale {
                remarks.push(format!(
                    "the model holds two poses of this image that differ by {angle:.3} degrees and {distance:.4} units: that of \
                     {used} is used, not that of {unused}"
                ));
            }
        };
        let rig_pose = self.rig_pose(image);
        if let Some(pose) = rig_pose {
            compare(pose, "its frame and rig", image.pose, "the file of images");
        }
        if let Some(pose) = text_pose {
            compare(image.pose, "images.bin", *pose, "images.txt");
        }
        if rig_pose.is_none() && (self.rigs.is_some() || self.frames.is_some()) {
            remarks.push(
                "the rigs and frames of the model give no pose of this image: that of the file of images is used".to_owned(),
            );
        }
        (rig_pose.unwrap_or(image.pose), remarks)
    }

    /// Returns the pose of an image that its frame and rig give.
    fn rig_pose(&self, image: &ImageRecord) -> Option<Pose> {
        let (camera, rig_pose) = self.frames.as_ref()?.get(&image.id)?;
        let camera_pose = self.rigs.as_ref()?.get(camera).copied()??;
        Some(camera_pose.after(*rig_pose))
    }

    /// Returns the identifier of an image and its camera at its pose, if the model of the camera is supported.
    fn posed_camera(&self, image: &ImageRecord) -> Option<(u64, Camera)> {
        let camera = self.cameras.get(&image.camera)?.camera.clone()?;
        let pose = self.rig_pose(image).unwrap_or(image.pose);
        Some((image.id, camera.with_pose(pose.rotation, pose.translation)))
    }

    /// Returns a remark if the median reprojection error is large, which means that cameras, poses and keypoints do not
    /// match. COLMAP itself filters points above 4 pixels.
    fn check_reprojection(&self, camera: &Camera, image: &ImageRecord) -> Option<String> {
        const PIXELS: f64 = 10.0;
        const FEW: usize = 10;
        let error = |([u, v], point): &([f64; 2], u64)| {
            let ([x, y], _) = camera.project(self.landmarks.get(point)?.position)?;
            Some((x + 0.5 - u).hypot(y + 0.5 - v))
        };
        let mut errors: Vec<f64> = image.keypoints.iter().filter_map(error).collect();
        if errors.len() < FEW {
            return None;
        }
        let middle = errors.len() / 2;
        let median = *errors.select_nth_unstable_by(middle, f64::total_cmp).1;
        (median > PIXELS).then(|| {
            format!(
                "half of the keypoints lie more than {median:.0} pixels from where the camera of the model sees their points: \
                 keypoints, cameras and poses may be of images of different sizes"
            )
        })
    }

    fn view(
        &self,
        folder: &Path,
        image: ImageRecord,
        text_pose: Option<&Pose>,
        covariances: &HashMap<u64, Covariance>,
    ) -> Result<View> {
        let camera = self.cameras.get(&image.camera).ok_or_else(|| {
            Error::format(
                folder,
                format!("image `{}` has no camera {}", image.name, image.camera),
            )
        })?;
        let (pose, mut remarks) = self.pose(&image, text_pose);
        let row = pose.rotation[2];
        let mut keypoints = Vec::with_capacity(image.keypoints.len());
        for ([u, v], point) in &image.keypoints {
            let Some(landmark) = self.landmarks.get(point) else {
                continue;
            };
            let along = row.iter().zip(landmark.position).map(|(r, x)| r * x);
            let depth = along.sum::<f64>() + pose.translation[2];
            if depth > 0.0 && depth.is_finite() {
                keypoints.push(Keypoint {
                    // In COLMAP the centre of the first pixel is at 0.5.
                    u: u - 0.5,
                    v: v - 0.5,
                    depth,
                    sigma: covariances
                        .get(point)
                        .and_then(|covariance| depth_deviation(covariance, row, depth)),
                    id: *point,
                });
            }
        }
        let mut depths: Vec<f64> = keypoints.iter().map(|point| point.depth).collect();
        if !depths.is_empty() {
            let middle = depths.len() / 2;
            let median = *depths.select_nth_unstable_by(middle, f64::total_cmp).1;
            keypoints.retain(|point| point.depth > CENTRE * median);
        }
        let size = [camera.size.0, camera.size.1].map(usize::try_from);
        let [Ok(width), Ok(height)] = size else {
            return Err(Error::format(folder, "a camera is implausibly large"));
        };
        let camera = camera.camera.clone().map(|camera| {
            camera
                .with_size((width, height))
                .with_pose(pose.rotation, pose.translation)
        });
        remarks.extend(
            camera
                .as_ref()
                .and_then(|camera| self.check_reprojection(camera, &image)),
        );
        Ok(View {
            size: (width, height),
            camera,
            ignored: image.keypoints.len() - keypoints.len(),
            keypoints,
            name: image.name,
            remarks,
        })
    }
}

/// Extensions of the two forms of a model.
const BINARY: &str = "bin";
const TEXT: &str = "txt";

/// A file of a model, before parsing.
struct ModelFile<'a, Bytes> {
    folder: &'a Path,
    name: &'a str,
    form: &'static str,
    bytes: Bytes,
}

impl<'a, Bytes: AsRef<[u8]>> ModelFile<'a, Bytes> {
    fn read(
        folder: &'a Path,
        name: &'a str,
        form: &'static str,
        file: impl Fn(&str) -> Result<Option<Bytes>>,
    ) -> Result<Option<Self>> {
        let found = file(&format!("{name}.{form}"))?;
        Ok(found.map(|bytes| Self {
            folder,
            name,
            form,
            bytes,
        }))
    }

    fn parse<T>(
        self,
        binary: impl Fn(&[u8]) -> Parsed<T>,
        text: impl Fn(&str) -> Parsed<T>,
    ) -> Result<T> {
        let Self {
            folder, name, form, ..
        } = self;
        let bytes = self.bytes.as_ref();
        let parsed = if form == BINARY {
            binary(bytes)
        } else {
            let found = std::str::from_utf8(bytes).map_err(|_| "is no text".to_owned());
            found.and_then(text)
        };
        parsed.map_err(|what| {
            Error::format(&folder.join(format!("{name}.{form}")), what)
                .hint("export the model again (`colmap model_converter`)")
        })
    }
}

/// Returns the files that every model has: `cameras`, `images` and `points3D`. All are binary, or else all are text, as
/// COLMAP chooses. If neither form is complete, each file is taken in the form that exists.
fn whole<Bytes: AsRef<[u8]>>(
    folder: &Path,
    file: impl Fn(&str) -> Result<Option<Bytes>>,
) -> Result<[ModelFile<'_, Bytes>; 3]> {
    let read = |name: &'static str, form| ModelFile::read(folder, name, form, &file);
    let all = |form| -> Result<_> {
        Ok([
            read("cameras", form)?,
            read("images", form)?,
            read("points3D", form)?,
        ])
    };
    let found = match all(BINARY)? {
        binary @ [Some(_), Some(_), Some(_)] => binary,
        [a, b, c] => match all(TEXT)? {
            text @ [Some(_), Some(_), Some(_)] => text,
            [d, e, f] => [a.or(d), b.or(e), c.or(f)],
        },
    };
    let missing = |name: &str| {
        Error::format(folder, format!("holds no {name}.{BINARY} or {name}.{TEXT}"))
            .hint("a sparse model of COLMAP is a folder such as sparse/0")
    };
    let [cameras, images, landmarks] = found;
    Ok([
        cameras.ok_or_else(|| missing("cameras"))?,
        images.ok_or_else(|| missing("images"))?,
        landmarks.ok_or_else(|| missing("points3D"))?,
    ])
}

/// Returns the poses of images in a text file that is not used, by name; none if it cannot be read.
fn poses_in_text<Bytes: AsRef<[u8]>>(
    images: Option<ModelFile<'_, Bytes>>,
) -> HashMap<String, Pose> {
    let images = images.and_then(|images| images.parse(|_| Ok(Vec::new()), text::images).ok());
    let images = images.unwrap_or_default().into_iter();
    images.map(|image| (image.name, image.pose)).collect()
}

#[cfg(test)]
mod tests;
