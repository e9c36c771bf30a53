//! One frame of a recording in memory.

use super::sweep::{PointMotions, Sweep};
use super::{Frames, SyncedFrame};
use crate::Recording;
use crate::message::{Header, MessageType, PointCloud, colours, depths, size_of};
use crate::rigid::Rigid;
use image::RgbImage;
use lsdc_core::DepthMap;
use lsdc_files::checks::implausible_unit;
use lsdc_files::error::{Error, Result};
use lsdc_files::{Camera, Sparse, Unit};
use std::path::Path;

/// The messages of a frame, as they are stored.
pub struct FrameMessages {
    frame: SyncedFrame,
    /// The message of the image.
    pub image: Vec<u8>,
    /// The message of the points.
    pub points: Vec<u8>,
}

/// A frame in memory.
pub struct DecodedFrame {
    /// Of the image.
    pub header: Header,
    /// The image.
    pub image: RgbImage,
    /// Its points, where the camera was when it took the image.
    pub points: Sparse,
    /// Points that were left out, as it is not known when they were measured, or where the scanner was then.
    pub unplaced: usize,
    /// Whether all points count at the stamp of their cloud, though those of other clouds do at their own times: these are not
    /// known here. A remark of the points says so.
    pub skewed: bool,
    /// The camera, at the origin unless it was given.
    pub camera: Option<Camera>,
}

/// The points of a frame in memory, without its image.
pub struct DecodedPoints {
    /// The points, where the camera was when it took the image.
    pub points: Sparse,
    /// Points that were left out, as it is not known when they were measured, or where the scanner was then.
    pub unplaced: usize,
    /// Whether all points count at the stamp of their cloud, though those of other clouds do at their own times: these are not
    /// known here. A remark of the points says so.
    pub skewed: bool,
    /// The camera, at the origin unless it was given.
    pub camera: Option<Camera>,
}

impl Frames {
    /// Reads the messages of a frame.
    ///
    /// # Errors
    /// A recording that cannot be read, or has changed.
    pub fn read(&self, recording: &mut Recording, frame: &SyncedFrame) -> Result<FrameMessages> {
        Ok(FrameMessages {
            frame: frame.clone(),
            image: recording.read(frame.location)?,
            points: recording.read(frame.points)?,
        })
    }

    /// From the points of a frame to its camera.
    fn motion(&self, frame: &SyncedFrame) -> Result<Rigid> {
        let Some(route) = &self.route else {
            return Ok(Rigid::IDENTITY);
        };
        let moved = self
            .transforms
            .between(route, [frame.points_stamp, frame.stamp]);
        moved.map_err(|gap| Error::config(gap.to_string()))
    }

    /// From the points of a cloud to the camera of its frame, each at its own time; none if that is not wanted, or they
    /// have no times.
    fn motions(&self, frame: &SyncedFrame, cloud: &PointCloud<'_>) -> Option<PointMotions<'_>> {
        let route = self.route.as_ref()?;
        let sweep = Sweep::of(cloud, frame.points_stamp, self.point_times.as_ref()?)?;
        Some(sweep.motions(&self.transforms, route, frame.stamp))
    }

    /// The camera of a frame, for images of the size that it was calibrated for.
    fn camera(&self, frame: &SyncedFrame) -> Option<Camera> {
        let given_camera = self.given_camera.clone();
        given_camera.or_else(|| self.cameras.at(frame.stamp))
    }

    /// The pixels of an image of depths in the frame of its camera, and what is doubtful about that.
    fn in_space(
        &self,
        frame: &SyncedFrame,
        depth: &DepthMap,
    ) -> Result<(Vec<[f64; 3]>, Vec<String>)> {
        let camera = self.depth_cameras.at(frame.points_stamp);
        let camera =
            camera.ok_or_else(|| Error::config("the camera of the depths is not known"))?;
        let camera = camera.resized((depth.width(), depth.height()))?;
        let position = |point: lsdc_core::Point| {
            camera.unproject([point.x as f64, point.y as f64], f64::from(point.depth))
        };
        let positions = depth.points().filter_map(position).collect();
        Ok((
            positions,
            Self::warnings(self.topics.depth_info.as_ref(), &camera),
        ))
    }

    /// What is doubtful about a camera, after the name of its topic.
    fn warnings(topic: Option<&String>, camera: &Camera) -> Vec<String> {
        let labelled = |warning| match topic {
            Some(topic) => format!("`{topic}`: {warning}"),
            None => warning,
        };
        camera.warnings().into_iter().map(labelled).collect()
    }
}

impl FrameMessages {
    /// The camera before it is fitted to the image, and the motion from the points to it, as text.
    pub fn projection(&self, frames: &Frames) -> String {
        let Self { frame, points, .. } = self;
        let camera = frames.camera(frame);
        let depth_camera = frames.depth_cameras.at(frame.points_stamp);
        let cloud = PointCloud::of(points).ok();
        let motions = cloud.and_then(|cloud| Some(frames.motions(frame, &cloud)?.edges));
        let motion = frames.motion(frame);
        let registered = frames.registered;
        format!("{camera:?} {depth_camera:?} {registered} {motion:?} {motions:?}")
    }

    /// The frame that the messages hold.
    ///
    /// # Errors
    /// Damaged messages; a camera of images of another shape; no points in the image.
    pub fn decode(&self, frames: &Frames) -> Result<DecodedFrame> {
        let (header, image, warning) = colours(frames.topics.image.1, &self.image)?;
        let size = (image.width() as usize, image.height() as usize);
        let of_image = warning.map(|warning| named(Path::new(&frames.topics.image.0), &warning));
        let DecodedPoints {
            points,
            unplaced,
            skewed,
            camera,
        } = self.points_in(frames, size, of_image.into_iter().collect())?;
        let header = Header {
            stamp: self.frame.stamp,
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

    /// The points of the frame alone: of the image, only the size is read.
    ///
    /// # Errors
    /// As for [`Self::decode`].
    pub fn decode_points(&self, frames: &Frames) -> Result<DecodedPoints> {
        let size = size_of(frames.topics.image.1, &self.image)?;
        self.points_in(frames, size, Vec::new())
    }

    /// The points in an image of this size, with these warnings and their own.
    fn points_in(
        &self,
        frames: &Frames,
        size: (usize, usize),
        mut warnings: Vec<String>,
    ) -> Result<DecodedPoints> {
        let Self { frame, points, .. } = self;
        let camera = frames.camera(frame);
        let camera = camera.map(|camera| camera.resized(size)).transpose()?;
        let motion = frames.motion(frame)?;
        let placed = || match (&camera, &frames.given_camera) {
            (Some(camera), Some(_)) => Ok(camera.clone()),
            (Some(camera), None) => Ok(camera.clone().moved(motion.matrix(), motion.translation())),
            (None, _) => Err(Error::config("the camera of the images is not known")),
        };
        let name = Path::new(&frames.topics.points.0);
        let (mut unplaced, mut skewed) = (0, false);
        if let Some(camera) = &camera {
            let topic = frames.topics.camera_info.as_ref();
            warnings.extend(Frames::warnings(
                topic.filter(|_| frames.given_camera.is_none()),
                camera,
            ));
        }
        let mut points = if frames.topics.points.1 == MessageType::PointCloud2 {
            let cloud = PointCloud::of(points)?;
            let unit = frames.unit.unwrap_or(Unit::METRE);
            let moved = frames.motions(frame, &cloud);
            let moved = moved.and_then(|motions| deskew(&cloud, &motions, unit.metres()));
            let mut found = if let (Some((positions, left_out)), Some(camera)) = (moved, &camera) {
                unplaced = left_out;
                Sparse::of_cloud(name, positions, camera, size)?
            } else {
                let in_metres = |position: [f64; 3]| position.map(|v| v * unit.metres());
                let positions = cloud.iter().map(in_metres);
                let mut found = Sparse::of_cloud(name, positions, &placed()?, size)?;
                skewed = frames.point_times.is_some();
                if skewed {
                    found.remarks.push(SKEWED.to_owned());
                }
                found
            };
            found.unit = unit;
            if frames.unit.is_none() {
                let depths = found.points.iter().map(|point| point.depth).collect();
                warnings
                    .extend(implausible_unit(unit, depths).map(|warning| named(name, &warning)));
            }
            found
        } else {
            let mut found = depths(frames.topics.points.1, points, frames.unit)?;
            let remarks = std::mem::take(&mut found.remarks);
            warnings.extend(remarks.iter().map(|warning| named(name, warning)));
            if frames.registered {
                Sparse::of_depths(name, found, size)?
            } else {
                let (positions, doubted) = frames.in_space(frame, &found.depth)?;
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

/// Where a cloud is without what others have.
const SKEWED: &str = "the points have no times, or transforms do not reach there: all count at the stamp of their cloud, and motion \
                      within the turn is not taken away";

/// What is doubtful about the messages of a topic.
fn named(topic: &Path, warning: &dyn std::fmt::Display) -> String {
    format!("`{}`: {warning}", topic.display())
}

/// The points of a cloud where the camera sees them, and how many have no known place, unless that are all. Coordinates
/// are stored in so many metres.
fn deskew(
    cloud: &PointCloud<'_>,
    motions: &PointMotions<'_>,
    metres: f64,
) -> Option<(Vec<[f64; 3]>, usize)> {
    let (mut placed, mut unplaced) = (0_usize, 0);
    let positions = cloud.timed()?.filter_map(|(position, time)| {
        let position = position.map(|v| v * metres);
        // What is no place is counted where it is projected.
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
