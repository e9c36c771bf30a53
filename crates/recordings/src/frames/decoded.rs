//! One frame of a recording in memory.

use super::rig::Rig;
use super::sweep::{PointMotions, Sweep};
use super::{Frames, SyncedFrame};
use crate::Recording;
use crate::message::{Header, MessageType, PointCloud, Timestamp, colours, depths, size_of};
use crate::rigid::Rigid;
use image::RgbImage;
use lsdc_core::DepthMap;
use lsdc_files::checks::implausible_unit;
use lsdc_files::error::{Error, Result};
use lsdc_files::{Camera, Sparse, Unit};
use std::path::Path;

/// The messages of a frame, as stored.
pub struct FrameMessages {
    frame: SyncedFrame,
    /// The message of the image.
    pub image: Vec<u8>,
    /// The message of the points.
    pub points: Vec<u8>,
}

/// A frame in memory.
pub struct DecodedFrame {
    /// Header of the image.
    pub header: Header,
    /// The image.
    pub image: RgbImage,
    /// Points, as seen by the camera at the time of the image.
    pub points: Sparse,
    /// Number of points left out because their time, or the pose of the scanner at that time, is unknown.
    pub unplaced: usize,
    /// Whether all points were taken at the stamp of their cloud although other clouds are deskewed, because times or poses
    /// are missing here. A remark of the points reports it.
    pub skewed: bool,
    /// Camera, at the origin unless it was given.
    pub camera: Option<Camera>,
}

/// The points of a frame in memory, without its image.
pub struct DecodedPoints {
    /// Points, as seen by the camera at the time of the image.
    pub points: Sparse,
    /// Number of points left out because their time, or the pose of the scanner at that time, is unknown.
    pub unplaced: usize,
    /// Whether all points were taken at the stamp of their cloud although other clouds are deskewed, because times or poses
    /// are missing here. A remark of the points reports it.
    pub skewed: bool,
    /// Camera, at the origin unless it was given.
    pub camera: Option<Camera>,
}

impl Frames {
    /// Reads the messages of a frame.
    ///
    /// # Errors
    /// The recording cannot be read, or has changed.
    pub fn read(&self, recording: &mut Recording, frame: &SyncedFrame) -> Result<FrameMessages> {
        Ok(FrameMessages {
            frame: frame.clone(),
            image: recording.read(frame.location)?,
            points: recording.read(frame.points)?,
        })
    }
}

impl FrameMessages {
    /// Returns the camera before it is fitted to the image, and the transform from the points to it, as text.
    pub fn projection(&self, frames: &Frames) -> String {
        let (rig, times) = (&frames.rig, FrameTimes::from(&self.frame));
        let camera = rig.camera(times.image);
        let depth_camera = rig.depth_cameras.at(times.points);
        let cloud = PointCloud::of(&self.points).ok();
        let motions = cloud.and_then(|cloud| Some(rig.motions(times, &cloud)?.edges));
        let motion = rig.known_motion(times);
        let registered = rig.registered;
        format!("{camera:?} {depth_camera:?} {registered} {motion:?} {motions:?}")
    }

    /// Decodes the frame.
    ///
    /// # Errors
    /// A message is damaged, the camera is of images of another shape, or no points are in the image.
    pub fn decode(&self, frames: &Frames) -> Result<DecodedFrame> {
        let messages = [self.image.as_slice(), self.points.as_slice()];
        frames.rig.decode(FrameTimes::from(&self.frame), messages)
    }

    /// Decodes only the points of the frame; of the image, only the size is read.
    ///
    /// # Errors
    /// As for [`Self::decode`].
    pub fn decode_points(&self, frames: &Frames) -> Result<DecodedPoints> {
        let size = size_of(frames.rig.topics.image.1, &self.image)?;
        let times = FrameTimes::from(&self.frame);
        frames.rig.points_in(times, &self.points, size, Vec::new())
    }
}

/// Times of the image and of the points of a frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct FrameTimes {
    pub(super) image: Timestamp,
    pub(super) points: Timestamp,
}

impl From<&SyncedFrame> for FrameTimes {
    fn from(frame: &SyncedFrame) -> Self {
        Self {
            image: frame.stamp,
            points: frame.points_stamp,
        }
    }
}

impl Rig {
    /// Returns the transform from the points of a frame to its camera.
    fn known_motion(&self, times: FrameTimes) -> Result<Rigid> {
        let moved = self.motion(times.points, times.image);
        moved.map_err(|gap| Error::config(gap.to_string()))
    }

    /// Returns the sweep of a cloud; `None` if its points have no times or all count at its stamp.
    pub(super) fn sweep(&self, stamp: Timestamp, cloud: &PointCloud<'_>) -> Option<Sweep> {
        Sweep::of(cloud, stamp, self.point_times.as_ref()?)
    }

    /// Returns the transform from each point of a cloud, at its own time, to the camera of its frame; `None` if motion is
    /// not compensated or points have no times.
    fn motions(&self, times: FrameTimes, cloud: &PointCloud<'_>) -> Option<PointMotions<'_>> {
        let route = self.route.as_ref()?;
        let sweep = self.sweep(times.points, cloud)?;
        Some(sweep.motions(&self.transforms, route, times.image))
    }

    /// Back-projects a depth image into the frame of its camera, and returns warnings about it.
    fn in_space(
        &self,
        times: FrameTimes,
        depth: &DepthMap,
    ) -> Result<(Vec<[f64; 3]>, Vec<String>)> {
        let camera = self.depth_cameras.at(times.points);
        let camera =
            camera.ok_or_else(|| Error::config("the camera of the depths is not known"))?;
        let camera = camera.resized((depth.width(), depth.height()))?;
        let position = |point: lsdc_core::Point| {
            camera.unproject([point.x as f64, point.y as f64], f64::from(point.depth))
        };
        let positions = depth.points().filter_map(position).collect();
        Ok((
            positions,
            camera_warnings(self.topics.depth_info.as_ref(), &camera),
        ))
    }

    /// Decodes the frame of an image message and a points message.
    ///
    /// # Errors
    /// As for [`FrameMessages::decode`].
    pub(super) fn decode(
        &self,
        times: FrameTimes,
        [image, points]: [&[u8]; 2],
    ) -> Result<DecodedFrame> {
        let (header, image, warning) = colours(self.topics.image.1, image)?;
        let size = (image.width() as usize, image.height() as usize);
        let of_image = warning.map(|warning| named(Path::new(&self.topics.image.0), &warning));
        let warnings = of_image.into_iter().collect();
        let DecodedPoints {
            points,
            unplaced,
            skewed,
            camera,
        } = self.points_in(times, points, size, warnings)?;
        let header = Header {
            stamp: times.image,
            ..header
        };
        Ok(DecodedFrame {
            header,
            image,
            points,
            unplaced,
            skewed,
            camera,
        })
    }

    /// Returns the points of a message in an image of this size, with the given warnings and further ones.
    fn points_in(
        &self,
        times: FrameTimes,
        points: &[u8],
        size: (usize, usize),
        mut warnings: Vec<String>,
    ) -> Result<DecodedPoints> {
        let camera = self.camera(times.image);
        let camera = camera.map(|camera| camera.resized(size)).transpose()?;
        let motion = self.known_motion(times)?;
        let placed = || match (&camera, &self.given_camera) {
            (Some(camera), Some(_)) => Ok(camera.clone()),
            (Some(camera), None) => Ok(camera.clone().moved(motion.matrix(), motion.translation())),
            (None, _) => Err(Error::config("the camera of the images is not known")),
        };
        let name = Path::new(&self.topics.points.0);
        let (mut unplaced, mut skewed) = (0, false);
        if let Some(camera) = &camera {
            let topic = self.topics.camera_info.as_ref();
            warnings.extend(camera_warnings(
                topic.filter(|_| self.given_camera.is_none()),
                camera,
            ));
        }
        let mut points = if self.topics.points.1 == MessageType::PointCloud2 {
            let cloud = PointCloud::of(points)?;
            let unit = self.unit.unwrap_or(Unit::METRE);
            let moved = self.motions(times, &cloud);
            let moved = moved.and_then(|motions| deskew(&cloud, &motions, unit.metres()));
            let mut found = if let (Some((positions, left_out)), Some(camera)) = (moved, &camera) {
                unplaced = left_out;
                Sparse::of_cloud(name, positions, camera, size)?
            } else {
                let in_metres = |position: [f64; 3]| position.map(|v| v * unit.metres());
                let positions = cloud.iter().map(in_metres);
                let mut found = Sparse::of_cloud(name, positions, &placed()?, size)?;
                skewed = self.point_times.is_some();
                if skewed {
                    found.remarks.push(SKEWED.to_owned());
                }
                found
            };
            found.unit = unit;
            if self.unit.is_none() {
                let depths = found.points.iter().map(|point| point.depth).collect();
                warnings
                    .extend(implausible_unit(unit, depths).map(|warning| named(name, &warning)));
            }
            found
        } else {
            let mut found = depths(self.topics.points.1, points, self.unit)?;
            let remarks = std::mem::take(&mut found.remarks);
            warnings.extend(remarks.iter().map(|warning| named(name, warning)));
            if self.registered {
                Sparse::of_depths(name, found, size)?
            } else {
                let (positions, doubted) = self.in_space(times, &found.depth)?;
                warnings.extend(doubted);
                let seen = Sparse::of_cloud(name, positions, &placed()?, size)?;
                Sparse {
                    unit: found.unit,
                    ignored: seen.ignored + found.depth.ignored(),
                    ..seen
                }
            }
        };
        points.remarks.extend(warnings);
        Ok(DecodedPoints {
            points,
            unplaced,
            skewed,
            camera,
        })
    }
}

/// Returns the warnings of a camera, prefixed by the name of its topic.
fn camera_warnings(topic: Option<&String>, camera: &Camera) -> Vec<String> {
    let labelled = |warning| match topic {
        Some(topic) => format!("`{topic}`: {warning}"),
        None => warning,
    };
    camera.warnings().into_iter().map(labelled).collect()
}

/// Remark about a cloud that is not deskewed although others are.
const SKEWED: &str = "the points have no times, or transforms do not reach there: all count at the stamp of their cloud, and motion \
                      within the turn is not taken away";

/// Prefixes a warning with the name of a topic.
fn named(topic: &Path, warning: &dyn std::fmt::Display) -> String {
    format!("`{}`: {warning}", topic.display())
}

/// Moves each point of a cloud to the camera, and counts the points that cannot be moved; `None` if that is all of them.
/// `metres` is the unit of the stored coordinates.
fn deskew(
    cloud: &PointCloud<'_>,
    motions: &PointMotions<'_>,
    metres: f64,
) -> Option<(Vec<[f64; 3]>, usize)> {
    let (mut placed, mut unplaced) = (0_usize, 0);
    let positions = cloud.timed()?.filter_map(|(position, time)| {
        let position = position.map(|v| v * metres);
        // Non-finite points are counted at projection.
        if position.iter().any(|v| !v.is_finite()) {
            return Some(position);
        }
        let motion = motions.at(time);
        let count = if motion.is_some() {
            &mut placed
        } else {
            &mut unplaced
        };
        *count += 1;
        Some(motion?.apply(position))
    });
    let positions = positions.collect();
    (placed > 0).then_some((positions, unplaced))
}
