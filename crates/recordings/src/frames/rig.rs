//! The sensors of a robot as described by its messages: cameras, their poses over time, and the times of points. Shared by
//! recordings and running robots.

use super::DropReason;
use super::cameras::{Cameras, registration_error};
use super::choice::{FrameTopics, is_rectified};
use super::options::FrameOptions;
use super::sweep::{ClockDetector, PointTimes};
use crate::message::{MessageType, PointCloud, Timestamp, transforms};
use crate::rigid::Rigid;
use crate::transforms::{Route, Transforms};
use lsdc_files::error::Result;
use lsdc_files::{Camera, Unit};

/// The sensors of a robot. Messages are [added](Self::add); [`Self::settle`] then decides how points are projected into
/// images.
#[derive(Clone, Debug)]
pub(super) struct Rig {
    pub(super) topics: FrameTopics,
    pub(super) unit: Option<Unit>,
    pub(super) given_camera: Option<Camera>,
    /// Frame in which motion is measured, if given.
    pub(super) fixed: Option<String>,
    deskew: bool,
    /// Frames of reference of images and of points, once both have arrived.
    pub(super) frames: Option<[String; 2]>,
    pub(super) cameras: Cameras,
    /// Cameras of the depth images.
    pub(super) depth_cameras: Cameras,
    /// Whether depth images share the pixels of the image.
    pub(super) registered: bool,
    pub(super) transforms: Transforms,
    /// Number of damaged transforms.
    pub(super) unusable_transforms: usize,
    /// Route from the points to the camera, unless the camera is given.
    pub(super) route: Option<Route>,
    detector: ClockDetector,
    /// Times of the points, if motion within a cloud is compensated.
    pub(super) point_times: Option<PointTimes>,
}

/// Depths count as registered up to this distance between the projections into both cameras, in pixels.
const MAX_REGISTRATION_ERROR: f64 = 1.0;

impl Rig {
    pub(super) fn new(topics: FrameTopics, options: &FrameOptions, transforms: Transforms) -> Self {
        let [cameras, depth_cameras] =
            [&topics.image.0, &topics.points.0].map(|topic| Cameras::new(is_rectified(topic)));
        Self {
            unit: options.unit,
            given_camera: options.camera.clone(),
            fixed: options.fixed.clone(),
            deskew: options.deskew && topics.points.1 == MessageType::PointCloud2,
            frames: None,
            cameras,
            depth_cameras,
            registered: false,
            transforms,
            unusable_transforms: 0,
            route: None,
            detector: ClockDetector::default(),
            point_times: None,
            topics,
        }
    }

    /// Adds a message about cameras or their poses. Returns whether anything has changed that [`Self::settle`] depends on.
    pub(super) fn add(&mut self, topic: &str, message: &[u8]) -> bool {
        let mut changed = false;
        if self.topics.camera_info.as_deref() == Some(topic) {
            changed |= self.cameras.add(message);
        }
        if self.topics.depth_info.as_deref() == Some(topic) {
            changed |= self.depth_cameras.add(message);
        }
        if self.topics.tf.iter().any(|tf| tf == topic) {
            let before = self.transforms.changes;
            match transforms(message) {
                Ok((found, damaged)) => {
                    self.unusable_transforms += damaged;
                    let is_static = topic.ends_with("static");
                    for found in found {
                        self.transforms.add(found, is_static);
                    }
                }
                Err(_) => self.unusable_transforms += 1,
            }
            changed |= self.transforms.changes != before;
        }
        changed
    }

    /// Examines the times of a cloud's points, if they are needed. Returns whether they were examined.
    pub(super) fn add_times(&mut self, message: &[u8], stamp: Timestamp) -> bool {
        if !self.deskew || self.detector.is_done() {
            return false;
        }
        // Damage is reported where the cloud is decoded.
        PointCloud::of(message)
            .map(|cloud| self.detector.add(&cloud, stamp))
            .is_ok()
    }

    /// Decides from all added messages how points are projected into images, with the transforms at `stamp`. Returns
    /// assumptions as remarks, a sentence each.
    ///
    /// # Errors
    /// A camera or transforms are missing.
    pub(super) fn settle(&mut self, stamp: Timestamp) -> Result<Vec<String>> {
        self.transforms.sort();
        (self.registered, self.route, self.point_times) = (false, None, None);
        let mut remarks = self.register_cameras(stamp);
        self.route = self.find_route()?;
        remarks.extend(self.find_point_times());
        Ok(remarks)
    }

    /// Returns a copy with only the transforms between points and camera.
    pub(super) fn snapshot(&self) -> Self {
        let transforms = self
            .route
            .as_ref()
            .map(|route| self.transforms.along(route))
            .unwrap_or_default();
        Self {
            topics: self.topics.clone(),
            given_camera: self.given_camera.clone(),
            fixed: self.fixed.clone(),
            frames: self.frames.clone(),
            cameras: self.cameras.clone(),
            depth_cameras: self.depth_cameras.clone(),
            transforms,
            route: self.route.clone(),
            detector: self.detector.clone(),
            point_times: self.point_times.clone(),
            ..*self
        }
    }

    /// Whether points are clouds, whose points have a single time unless they are deskewed.
    pub(super) fn has_clouds(&self) -> bool {
        self.topics.points.1 == MessageType::PointCloud2
    }

    /// Places cameras in their frames, decides whether depths are registered to the image, and returns remarks about both.
    fn register_cameras(&mut self, stamp: Timestamp) -> Vec<String> {
        let mut remarks = Vec::new();
        let Some([image, cloud]) = &self.frames else {
            return remarks;
        };
        let topics = &self.topics;
        for (cameras, topic, frame) in [
            (&mut self.cameras, &topics.camera_info, image),
            (&mut self.depth_cameras, &topics.depth_info, cloud),
        ] {
            let Some(topic) = topic else {
                continue;
            };
            remarks.extend(cameras.apply_baseline(topic, frame, stamp, &self.transforms));
            if let Some(own) = cameras.frame.as_ref().filter(|own| *own != frame) {
                remarks.push(format!(
                    "`{topic}` is in the frame `{own}`, but its images are in `{frame}`, which is used"
                ));
            }
        }
        let same = image == cloud && self.given_camera.is_none();
        if same && image.is_empty() {
            remarks.push(
                "the messages name no frame of reference: the points are taken to be in that of the camera".to_owned(),
            );
        }
        if self.has_clouds() || !same && self.given_camera.is_none() {
            return remarks;
        }
        let why = if self.given_camera.is_some() {
            "the camera is given".to_owned()
        } else {
            format!("both are in the frame `{image}`")
        };
        let camera = self.given_camera.clone().or_else(|| self.cameras.at(stamp));
        let remark = match (camera, self.depth_cameras.at(stamp)) {
            (Some(camera), Some(depths)) => {
                let pixels = registration_error(&depths, &camera);
                self.registered = pixels <= MAX_REGISTRATION_ERROR;
                (!self.registered).then(|| {
                    format!(
                        "the cameras of depths ({depths}) and images ({camera}) differ by up to {pixels:.1} pixels, though {why}: the \
                         depths are not taken for registered to the image, but projected by both cameras"
                    )
                })
            }
            (camera, _) => {
                self.registered = true;
                let whose = match camera {
                    Some(_) => "of the depths",
                    None => "of the images",
                };
                Some(format!(
                    "the depths are taken for registered to the pixels of the image, as {why}: the recording has no camera {whose} \
                     to check it"
                ))
            }
        };
        remarks.extend(remark);
        remarks
    }

    /// Returns the route from the points to the camera, unless the camera is given or the points are its own depths.
    fn find_route(&self) -> Result<Option<Route>> {
        let Some([image, cloud]) = &self.frames else {
            return Ok(None);
        };
        // Within a single frame no transform is needed, whatever time has passed.
        if self.given_camera.is_some() || !self.has_clouds() && image == cloud {
            return Ok(None);
        }
        let [cameras, depth_cameras] = [&self.cameras, &self.depth_cameras];
        self.topics
            .check_cameras(cameras.is_empty(), depth_cameras.is_empty())
            .map_err(|missing| {
                let first_error = cameras.first_error().or(depth_cameras.first_error());
                match (first_error, missing.advice()) {
                    (Some(first_error), Some(hint)) => first_error.hint(hint),
                    _ => missing,
                }
            })?;
        self.transforms
            .route(cloud, image, self.fixed.as_deref())
            .map(Some)
    }

    /// Enables motion compensation within clouds, or returns a remark on why it is not possible although points have times.
    fn find_point_times(&mut self) -> Option<String> {
        let route = self.route.as_ref();
        let moves = route.is_some_and(|route| self.transforms.is_dynamic(route));
        let why = match self.detector.found() {
            Ok(Some(found)) if moves => {
                self.point_times = Some(found);
                return None;
            }
            Ok(None) => return None,
            Ok(Some(PointTimes { field, .. })) => format!(
                "the points have times of their own (`{field}`), but no transforms that move lead from them to the camera"
            ),
            Err((field, clouds)) => format!(
                "most of the first {clouds} clouds have no times of their points in `{field}`: these are all the same, or far from \
                 the stamp of the cloud"
            ),
        };
        Some(format!("{why}; all count at the stamp of their cloud"))
    }

    /// Returns the transform from points at one time to the camera at another.
    pub(super) fn motion(
        &self,
        points: Timestamp,
        image: Timestamp,
    ) -> std::result::Result<Rigid, DropReason> {
        let Some(route) = &self.route else {
            return Ok(Rigid::IDENTITY);
        };
        self.transforms
            .between(route, [points, image])
            .map_err(DropReason::NoTransform)
    }

    /// Returns the camera of the images at a time, for images of its calibrated size.
    pub(super) fn camera(&self, stamp: Timestamp) -> Option<Camera> {
        let given_camera = self.given_camera.clone();
        given_camera.or_else(|| self.cameras.at(stamp))
    }
}
