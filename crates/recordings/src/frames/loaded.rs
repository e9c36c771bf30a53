//! One frame of a recording in memory.

use super::sweep::{Motions, Sweep};
use super::{Frame, Frames};
use crate::Recording;
use crate::message::{Header, Kind, Points, colours, depths};
use crate::rigid::Rigid;
use image::RgbImage;
use lsdc_core::DepthMap;
use lsdc_files::doubts::implausible_unit;
use lsdc_files::error::{Error, Result};
use lsdc_files::{Camera, Sparse, Unit};
use std::path::Path;

/// The messages of a frame, as they are stored.
pub struct Stored {
    frame: Frame,
    /// The message of the image.
    pub image: Vec<u8>,
    /// The message of the points.
    pub points: Vec<u8>,
}

/// A frame in memory.
pub struct Loaded {
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

impl Frames {
    /// Reads the messages of a frame.
    ///
    /// # Errors
    /// A recording that cannot be read, or has changed.
    pub fn read(&self, recording: &mut Recording, frame: &Frame) -> Result<Stored> {
        Ok(Stored {
            frame: frame.clone(),
            image: recording.read(frame.place)?,
            points: recording.read(frame.points)?,
        })
    }

    /// From the points of a frame to its camera.
    fn motion(&self, frame: &Frame) -> Result<Rigid> {
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
    fn motions(&self, frame: &Frame, cloud: &Points<'_>) -> Option<Motions<'_>> {
        let route = self.route.as_ref()?;
        let sweep = Sweep::of(cloud, frame.points_stamp, self.deskewed.as_ref()?)?;
        Some(sweep.motions(&self.transforms, route, frame.stamp))
    }

    /// The camera of a frame for an image of this width and height.
    fn camera(&self, frame: &Frame, size: (usize, usize)) -> Result<Option<Camera>> {
        let found = self.camera_at(frame);
        found.map(|camera| camera.resized(size)).transpose()
    }

    fn camera_at(&self, frame: &Frame) -> Option<Camera> {
        let given = self.given.clone();
        given.or_else(|| self.cameras.at(frame.stamp))
    }

    /// The pixels of an image of depths in the frame of its camera, and what is doubtful about that.
    fn in_space(&self, frame: &Frame, depth: &DepthMap) -> Result<(Vec<[f64; 3]>, Vec<String>)> {
        let camera = self.depth_cameras.at(frame.points_stamp);
        let camera =
            camera.ok_or_else(|| Error::config("the camera of the depths is not known"))?;
        let camera = camera.resized((depth.width(), depth.height()))?;
        let place = |point: lsdc_core::Point| {
            camera.unproject([point.x as f64, point.y as f64], f64::from(point.depth))
        };
        let places = depth.points().filter_map(place).collect();
        Ok((
            places,
            Self::doubts(self.topics.depth_info.as_ref(), &camera),
        ))
    }

    /// What is doubtful about a camera, after the name of its topic.
    fn doubts(topic: Option<&String>, camera: &Camera) -> Vec<String> {
        let said = |doubt| match topic {
            Some(topic) => format!("`{topic}`: {doubt}"),
            None => doubt,
        };
        camera.doubts().into_iter().map(said).collect()
    }
}

impl Stored {
    /// The camera before it is fitted to the image, and the motion from the points to it, as text.
    pub fn projection(&self, frames: &Frames) -> String {
        let Self { frame, points, .. } = self;
        let camera = frames.camera_at(frame);
        let depth_camera = frames.depth_cameras.at(frame.points_stamp);
        let cloud = Points::of(points).ok();
        let motions = cloud.and_then(|cloud| Some(frames.motions(frame, &cloud)?.edges));
        let motion = frames.motion(frame);
        let registered = frames.registered;
        format!("{camera:?} {depth_camera:?} {registered} {motion:?} {motions:?}")
    }

    /// The frame that the messages hold.
    ///
    /// # Errors
    /// Damaged messages; a camera of images of another shape; no points in the image.
    pub fn decode(&self, frames: &Frames) -> Result<Loaded> {
        let Self {
            frame,
            image,
            points,
        } = self;
        let (header, image, doubt) = colours(frames.topics.image.1, image)?;
        let size = (image.width() as usize, image.height() as usize);
        let camera = frames.camera(frame, size)?;
        let motion = frames.motion(frame)?;
        let placed = || match (&camera, &frames.given) {
            (Some(camera), Some(_)) => Ok(camera.clone()),
            (Some(camera), None) => Ok(camera.clone().moved(motion.matrix(), motion.translation())),
            (None, _) => Err(Error::config("the camera of the images is not known")),
        };
        let name = Path::new(&frames.topics.points.0);
        let (mut unplaced, mut skewed) = (0, false);
        let of_image = doubt.map(|doubt| named(Path::new(&frames.topics.image.0), &doubt));
        let mut doubts: Vec<String> = of_image.into_iter().collect();
        if let Some(camera) = &camera {
            let topic = frames.topics.camera_info.as_ref();
            doubts.extend(Frames::doubts(
                topic.filter(|_| frames.given.is_none()),
                camera,
            ));
        }
        let mut points = if frames.topics.points.1 == Kind::PointCloud2 {
            let cloud = Points::of(points)?;
            let unit = frames.unit.unwrap_or(Unit::METRE);
            let places = || cloud.iter().map(|place| place.map(|v| v * unit.metres()));
            let moved = frames.motions(frame, &cloud);
            let moved = moved.and_then(|motions| deskewed(&cloud, &motions, unit.metres()));
            let mut found = if let (Some((places, left_out)), Some(camera)) = (moved, &camera) {
                unplaced = left_out;
                Sparse::of_cloud(name, places, camera, size)?
            } else {
                let mut found = Sparse::of_cloud(name, places(), &placed()?, size)?;
                skewed = frames.deskewed.is_some();
                if skewed {
                    found.remarks.push(SKEWED.to_owned());
                }
                found
            };
            found.unit = unit;
            if frames.unit.is_none() {
                let depths = found.points.iter().map(|point| point.depth).collect();
                doubts.extend(implausible_unit(unit, depths).map(|doubt| named(name, &doubt)));
            }
            found
        } else {
            let mut found = depths(frames.topics.points.1, points, frames.unit)?;
            let remarks = std::mem::take(&mut found.remarks);
            doubts.extend(remarks.iter().map(|doubt| named(name, doubt)));
            if frames.registered {
                Sparse::of_depths(name, found, size)?
            } else {
                let (places, doubted) = frames.in_space(frame, &found.depth)?;
                doubts.extend(doubted);
                let seen = Sparse::of_cloud(name, places, &placed()?, size)?;
                Sparse {
                    unit: found.unit,
                    ignored: seen.ignored + found.depth.ignored(),
                    ..seen
                }
            }
        };
        points.remarks.extend(doubts);
        let header = Header {
            stamp: frame.stamp,
            ..header
        };
        Ok(Loaded {
            header,
            image,
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
fn named(topic: &Path, doubt: &dyn std::fmt::Display) -> String {
    format!("`{}`: {doubt}", topic.display())
}

/// The points of a cloud where the camera sees them, and how many have no known place, unless that are all. Coordinates
/// are stored in so many metres.
fn deskewed(
    cloud: &Points<'_>,
    motions: &Motions<'_>,
    metres: f64,
) -> Option<(Vec<[f64; 3]>, usize)> {
    let (mut placed, mut unplaced) = (0_usize, 0);
    let places = cloud.timed()?.filter_map(|(place, time)| {
        let place = place.map(|v| v * metres);
        // What is no place is counted where it is projected.
        if place.iter().any(|v| !v.is_finite()) {
            return Some(place);
        }
        let motion = motions.at(time);
        let count = if motion.is_some() {
            &mut placed
        } else {
            &mut unplaced
        };
        *count += 1;
        Some(motion?.apply(place))
    });
    let places = places.collect();
    (placed > 0).then_some((places, unplaced))
}
