//! One frame of a recording in memory.

use super::{Frame, Frames};
use crate::Recording;
use crate::message::{DepthImage, Header, Kind, Points, colours, depths};
use crate::rigid::Rigid;
use image::RgbImage;
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

    /// The camera of a frame before it is fitted to the image, and the motion from its points to it, as text.
    pub fn projection(&self, frame: &Frame) -> String {
        let camera = self
            .given
            .as_ref()
            .or_else(|| self.cameras.valid(frame.stamp));
        let depth_camera = self.depth_cameras.valid(frame.points_stamp);
        format!("{camera:?} {depth_camera:?} {:?}", self.motion(frame))
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

    /// The camera of a frame for an image of this width and height.
    fn camera(&self, frame: &Frame, size: (usize, usize)) -> Result<Option<Camera>> {
        let found = self
            .given
            .as_ref()
            .or_else(|| self.cameras.valid(frame.stamp));
        found.map(|camera| camera.resized(size)).transpose()
    }
}

impl Stored {
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
        let (header, image) = colours(frames.topics.image.1, image)?;
        let size = (image.width() as usize, image.height() as usize);
        let camera = frames.camera(frame, size)?;
        let motion = frames.motion(frame)?;
        let placed = || match (&camera, &frames.given) {
            (Some(camera), Some(_)) => Ok(camera.clone()),
            (Some(camera), None) => Ok(camera
                .clone()
                .with_pose(motion.matrix(), motion.translation())),
            (None, _) => Err(Error::config("the camera of the images is not known")),
        };
        let name = Path::new(&frames.topics.points.0);
        let points = if frames.topics.points.1 == Kind::PointCloud2 {
            let cloud = Points::of(points)?;
            Sparse::of_cloud(name, cloud.iter(), &placed()?, size)?
        } else {
            let unit = |whole: bool| {
                let usual = if whole { Unit::MILLIMETRE } else { Unit::METRE };
                frames.unit.unwrap_or(usual)
            };
            let found = depths(frames.topics.points.1, points, |whole| unit(whole).metres())?;
            let unit = unit(found.whole);
            if frames.route.is_none() {
                Sparse::of_depths(name, found.depth, unit, size)?
            } else {
                let eye = frames.depth_cameras.valid(frame.points_stamp);
                let places = in_space(&found, eye)?;
                let seen = Sparse::of_cloud(name, places, &placed()?, size)?;
                Sparse { unit, ..seen }
            }
        };
        let header = Header {
            stamp: frame.stamp,
            ..header
        };
        Ok(Loaded {
            header,
            image,
            points,
            camera,
        })
    }
}

/// The pixels of an image of depths in the frame of its camera.
fn in_space(found: &DepthImage, camera: Option<&Camera>) -> Result<Vec<[f64; 3]>> {
    let camera = camera.ok_or_else(|| Error::config("the camera of the depths is not known"))?;
    let depth = &found.depth;
    let camera = camera.resized((depth.width(), depth.height()))?;
    let place = |point: lsdc_core::Point| {
        camera.unproject([point.x as f64, point.y as f64], f64::from(point.depth))
    };
    Ok(depth.points().filter_map(place).collect())
}
