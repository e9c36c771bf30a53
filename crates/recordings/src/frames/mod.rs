//! The frames of a recording: each image with the points that are nearest in time.

mod cameras;
mod choice;
mod decoded;
mod options;
mod poses;
mod stamps;
mod sweep;

pub use decoded::{DecodedFrame, DecodedPoints, FrameMessages};
pub use options::FrameOptions;
pub use sweep::PointTimes;
pub(crate) use sweep::timed;

use crate::container::{MessageLocation, MessageTimes};
use crate::message::{Header, MessageType, PointCloud, Timestamp, transforms};
use crate::series::TimeSeries;
use crate::transforms::{Route, TransformGap, Transforms};
use crate::{Defects, Recording};
use cameras::{CameraCollector, Cameras, registration_error};
use choice::{Topics, is_rectified};
use lsdc_files::error::{Error, Result};
use lsdc_files::{Camera, Unit};
use std::time::Duration;
use sweep::ClockDetector;

/// The frames of a recording. As many images as there are messages are either found or dropped.
pub struct Frames {
    topics: Topics,
    /// In the order of the recording.
    pub found: Vec<SyncedFrame>,
    /// Images that cannot be used, in the order of the recording.
    pub dropped: Vec<DroppedFrame>,
    /// What was assumed or left out and should be checked, a sentence each.
    pub remarks: Vec<String>,
    unit: Option<Unit>,
    given_camera: Option<Camera>,
    cameras: Cameras,
    /// Of images of depths.
    depth_cameras: Cameras,
    /// Whether images of depths are of the pixels of the image.
    registered: bool,
    transforms: Transforms,
    /// From the points to the camera, unless that is given.
    route: Option<Route>,
    /// The frame of reference of the images, and that of the points.
    frame_ids: [String; 2],
    /// The frame that motion is measured in, if it was given.
    fixed: Option<String>,
    /// The times of the points, if motion within a cloud is compensated.
    point_times: Option<PointTimes>,
}

/// An image and the points nearest to it in time.
#[derive(Clone, Debug)]
pub struct SyncedFrame {
    /// When the image was taken.
    pub stamp: Timestamp,
    /// Where the image is in the recording.
    pub location: MessageLocation,
    /// When the image was recorded and published, in nanoseconds.
    pub times: MessageTimes,
    /// Where the points are in the recording. Images that were taken in quick succession have the same ones.
    pub points: MessageLocation,
    /// When the points were measured.
    pub points_stamp: Timestamp,
}

/// An image that cannot be used.
#[derive(Clone, Debug)]
pub struct DroppedFrame {
    /// When it was taken.
    pub stamp: Timestamp,
    /// Why it cannot be used.
    pub reason: DropReason,
}

/// Why an image cannot be used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum DropReason {
    /// The nearest points are so many nanoseconds away, if there are any.
    NoPoints(Option<u64>),
    /// It is not known where camera and points were.
    NoTransform(TransformGap),
    /// It is of another frame of reference than the first image, or its points than the first points.
    OtherFrame(String),
    /// The message is damaged.
    Damaged(String),
}

impl DropReason {
    /// Which kind of reason it is, for counting.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::NoPoints(_) => "without points near their time",
            Self::NoTransform(gap) => gap.kind(),
            Self::OtherFrame(_) => "of another frame of reference",
            Self::Damaged(_) => "damaged",
        }
    }
}

impl std::fmt::Display for DropReason {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::NoPoints(None) => write!(f, "there are no points"),
            Self::NoPoints(Some(distance)) => {
                write!(
                    f,
                    "the nearest points are {:.3} s away",
                    *distance as f64 * 1e-9
                )
            }
            Self::NoTransform(gap) => write!(f, "{gap}"),
            Self::OtherFrame(frame) => write!(f, "it, or its points, are in the frame `{frame}`"),
            Self::Damaged(what) => write!(f, "{what}"),
        }
    }
}

/// A message with its times.
#[derive(Clone, Debug)]
struct TimedMessage {
    location: MessageLocation,
    times: MessageTimes,
    /// The frame of reference, if it is not that of the first.
    other_frame: Option<String>,
}

/// The messages of a topic, collected in a pass over a recording.
#[derive(Default)]
struct TopicMessages {
    found: Vec<(Timestamp, TimedMessage)>,
    /// The frame of reference of the first.
    frame: Option<String>,
    damaged: Vec<DroppedFrame>,
    /// Messages without a stamp, which are taken at the time that they were recorded.
    unstamped: usize,
}

impl TopicMessages {
    fn add(&mut self, message: &crate::Message<'_>) {
        let recorded = i64::try_from(message.times.log).unwrap_or(0);
        let header = match Header::of(message.data) {
            Ok(header) => header,
            Err(error) => {
                self.damaged.push(DroppedFrame {
                    stamp: recorded,
                    reason: DropReason::Damaged(error.with_causes()),
                });
                return;
            }
        };
        let stamp = if header.stamp == 0 {
            self.unstamped += 1;
            recorded
        } else {
            header.stamp
        };
        let first = self.frame.get_or_insert_with(|| header.frame.clone());
        let measured = TimedMessage {
            location: message.location,
            times: message.times,
            other_frame: (*first != header.frame).then_some(header.frame),
        };
        self.found.push((stamp, measured));
    }
}

impl Frames {
    /// Finds the frames of a recording, which is read once for it, but for topics that are not needed.
    ///
    /// # Errors
    /// Topics that are not there or are of another type; a camera or transforms that are missing; a recording that
    /// cannot be read.
    pub fn of(recording: &mut Recording, options: &FrameOptions) -> Result<Self> {
        let topics = Topics::choose(recording, options)?;
        let (mut images, mut points) = (TopicMessages::default(), TopicMessages::default());
        let [mut cameras, mut depth_cameras] = [&topics.image.0, &topics.points.0]
            .map(|topic| CameraCollector::new(is_rectified(topic)));
        let mut tree = Transforms::default();
        let mut unusable = 0;
        let deskew = options.deskew && topics.points.1 == MessageType::PointCloud2;
        let mut detector = ClockDetector::default();
        let defects =
            recording.visit(&|topic| topics.has(&topic.name), &mut |topic, message| {
                let name = topic.name.as_str();
                if name == topics.image.0 {
                    images.add(message);
                }
                if name == topics.points.0 {
                    points.add(message);
                    if let (true, Some((stamp, _))) = (deskew, points.found.last()) {
                        // What is damaged is said where it is needed.
                        let _ =
                            PointCloud::of(message.data).map(|cloud| detector.add(&cloud, *stamp));
                    }
                }
                if topics.camera_info.as_deref() == Some(name) {
                    cameras.add(message.data);
                }
                if topics.depth_info.as_deref() == Some(name) {
                    depth_cameras.add(message.data);
                }
                if topics.tf.iter().any(|tf| tf == name) {
                    match transforms(message.data) {
                        Ok((found, damaged)) => {
                            unusable += damaged;
                            let is_static = name.ends_with("static");
                            for found in found {
                                tree.add(found, is_static);
                            }
                        }
                        Err(_) => unusable += 1,
                    }
                }
                Ok(())
            })?;
        tree.sort();
        let unusable = [
            (
                cameras.unusable + depth_cameras.unusable,
                "messages of cameras cannot be used and are left out",
            ),
            (unusable, "transforms are damaged and left out"),
        ];
        let first_error = cameras
            .first_error
            .take()
            .or(depth_cameras.first_error.take());
        let mut frames = Self {
            found: Vec::new(),
            dropped: std::mem::take(&mut images.damaged),
            remarks: remarks(&defects, [&images, &points], &unusable, &tree),
            unit: options.unit,
            given_camera: options.camera.clone(),
            cameras: cameras.cameras(),
            depth_cameras: depth_cameras.cameras(),
            registered: false,
            transforms: tree,
            route: None,
            frame_ids: [&images, &points].map(|found| found.frame.clone().unwrap_or_default()),
            fixed: options.fixed.clone(),
            point_times: None,
            topics,
        };
        frames.register_cameras([&images, &points]);
        frames.route = frames.find_route([&images, &points], options, first_error)?;
        frames.deskew(detector);
        frames.pair(images, points, options.tolerance);
        Ok(frames)
    }

    /// The times of the points, if motion within a cloud is compensated.
    pub fn point_times(&self) -> Option<&PointTimes> {
        self.point_times.as_ref()
    }

    /// The camera of the images, and what of it holds: of unrectified images K and D, of rectified ones P. Nothing if no
    /// topic has one.
    pub fn seen_by(&self) -> Option<String> {
        let Topics {
            image, camera_info, ..
        } = &self.topics;
        if self.given_camera.is_some() {
            return Some("given, in the frame of the points".to_owned());
        }
        let topic = camera_info.as_ref().filter(|_| !self.cameras.is_empty())?;
        Some(if is_rectified(&image.0) {
            format!(
                "P of {topic}: the images are taken for rectified, as {} says `image_rect`",
                image.0
            )
        } else {
            format!(
                "K and D of {topic}: the images are taken for unrectified, as {} does not say `image_rect`",
                image.0
            )
        })
    }

    /// Whether points are clouds, all of one time unless they are deskewed.
    pub fn has_clouds(&self) -> bool {
        self.topics.points.1 == MessageType::PointCloud2
    }

    /// Places cameras in their frames, decides whether depths are registered to the image, and adds remarks about both.
    fn register_cameras(&mut self, [images, points]: [&TopicMessages; 2]) {
        let (Some(image), Some(cloud)) = (&images.frame, &points.frame) else {
            return;
        };
        let stamp = images.found.first().map_or(0, |(stamp, _)| *stamp);
        let topics = &self.topics;
        for (cameras, topic, frame) in [
            (&mut self.cameras, &topics.camera_info, image),
            (&mut self.depth_cameras, &topics.depth_info, cloud),
        ] {
            let Some(topic) = topic else {
                continue;
            };
            self.remarks
                .extend(cameras.apply_baseline(topic, frame, stamp, &self.transforms));
            if let Some(own) = cameras.frame.as_ref().filter(|own| *own != frame) {
                self.remarks.push(format!(
                    "`{topic}` is in the frame `{own}`, but its images are in `{frame}`, which is used"
                ));
            }
        }
        let same = image == cloud && self.given_camera.is_none();
        if same && image.is_empty() {
            self.remarks.push(
                "the messages name no frame of reference: the points are taken to be in that of the camera".to_owned(),
            );
        }
        if self.has_clouds() || !same && self.given_camera.is_none() {
            return;
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
        self.remarks.extend(remark);
    }

    /// Enables motion compensation within clouds, or adds a remark why it is not possible though points have times.
    fn deskew(&mut self, detector: ClockDetector) {
        let route = self.route.as_ref();
        let moves = route.is_some_and(|route| self.transforms.is_dynamic(route));
        let why = match detector.found() {
            Ok(Some(found)) if moves => {
                self.point_times = Some(found);
                return;
            }
            Ok(None) => return,
            Ok(Some(PointTimes { field, .. })) => format!(
                "the points have times of their own (`{field}`), but no transforms that move lead from them to the camera"
            ),
            Err((field, clouds)) => format!(
                "most of the first {clouds} clouds have no times of their points in `{field}`: these are all the same, or far from \
                 the stamp of the cloud"
            ),
        };
        let remark = format!("{why}; all count at the stamp of their cloud");
        self.remarks.push(remark);
    }

    /// The route from the points to the camera, unless the camera is given or its own depths are the points.
    /// `first_error` is what is wrong with the first camera that is none.
    fn find_route(
        &self,
        [images, points]: [&TopicMessages; 2],
        options: &FrameOptions,
        first_error: Option<Error>,
    ) -> Result<Option<Route>> {
        let (Some(image), Some(cloud)) = (&images.frame, &points.frame) else {
            return Ok(None);
        };
        // What was in one frame stays there, whatever time has passed.
        if self.given_camera.is_some() || !self.has_clouds() && image == cloud {
            return Ok(None);
        }
        self.topics
            .check_cameras(self.cameras.is_empty(), self.depth_cameras.is_empty())
            .map_err(|missing| match (first_error, missing.advice()) {
                (Some(first_error), Some(hint)) => first_error.hint(hint),
                _ => missing,
            })?;
        self.transforms
            .route(cloud, image, options.fixed.as_deref())
            .map(Some)
    }

    /// Gives each image the points that are nearest in time.
    fn pair(&mut self, images: TopicMessages, points: TopicMessages, tolerance: Duration) {
        let clouds = TimeSeries::new(points.found);
        for (stamp, image) in images.found {
            let found = self.paired(stamp, &image, &clouds, tolerance);
            match found {
                Ok(frame) => self.found.push(frame),
                Err(reason) => self.dropped.push(DroppedFrame { stamp, reason }),
            }
        }
    }

    fn paired(
        &self,
        stamp: Timestamp,
        image: &TimedMessage,
        clouds: &TimeSeries<TimedMessage>,
        tolerance: Duration,
    ) -> std::result::Result<SyncedFrame, DropReason> {
        let (time, cloud) = clouds.nearest(stamp).ok_or(DropReason::NoPoints(None))?;
        let distance = time.abs_diff(stamp);
        if u128::from(distance) > tolerance.as_nanos() {
            return Err(DropReason::NoPoints(Some(distance)));
        }
        if let Some(frame) = image.other_frame.as_ref().or(cloud.other_frame.as_ref()) {
            return Err(DropReason::OtherFrame(frame.clone()));
        }
        if let Some(route) = &self.route {
            let moved = self.transforms.between(route, [*time, stamp]);
            moved.map_err(DropReason::NoTransform)?;
        }
        Ok(SyncedFrame {
            stamp,
            location: image.location,
            times: image.times,
            points: cloud.location,
            points_stamp: *time,
        })
    }

    /// What the frames are made of, as text: two recordings of which it is the same give the same frames.
    pub fn about(&self) -> String {
        let Topics {
            image,
            points,
            camera_info,
            tf,
            ..
        } = &self.topics;
        let camera = camera_info.as_deref().unwrap_or("none");
        let fixed = self.route.as_ref().map_or("none", Route::fixed);
        let times = self
            .point_times
            .as_ref()
            .map_or("none", |found| &found.field);
        format!(
            "{} with {}, camera {camera}, transforms {}, motion in {fixed}, times {times}",
            image.0,
            points.0,
            tf.join(" ")
        )
    }
}

/// Depths are registered if both cameras see the same points at most so many pixels apart.
const MAX_REGISTRATION_ERROR: f64 = 1.0;

/// What should be said of a recording.
fn remarks(
    defects: &Defects,
    [images, points]: [&TopicMessages; 2],
    unusable: &[(usize, &str)],
    tree: &Transforms,
) -> Vec<String> {
    let mut remarks: Vec<String> = defects.lines().collect();
    let unstamped = images.unstamped + points.unstamped;
    let counts = [
        (
            unstamped,
            "messages without a stamp are taken at the time that they were recorded",
        ),
        (
            points.damaged.len(),
            "messages of points are damaged and left out",
        ),
        (
            tree.reparented,
            "transforms are left out, as their frames were in another one before",
        ),
        (
            tree.replaced,
            "transforms that hold at all times are replaced by later ones that differ",
        ),
    ];
    let counts = counts
        .iter()
        .chain(unusable)
        .filter(|(count, _)| *count > 0);
    remarks.extend(counts.map(|(count, what)| format!("{count} {what}")));
    remarks
}
