//! The frames of a running robot: each image with the points nearest in time, as soon as the points and the transforms of
//! both have arrived.

use super::choice::FrameTopics;
use super::decoded::{DecodedFrame, FrameTimes};
use super::options::FrameOptions;
use super::poses::CameraPose;
use super::rig::Rig;
use super::sweep::Sweep;
use super::{DropReason, DroppedFrame};
use crate::message::{Header, PointCloud, Timestamp, restamped_camera_info};
use crate::series::TimeSeries;
use crate::transforms::{Route, Transforms};
use lsdc_files::error::Result;
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

/// Largest number of images that wait for points and transforms.
const IMAGES: usize = 16;
/// Largest number of cached clouds.
const CLOUDS: usize = 32;
/// Largest size of waiting images, and of cached clouds, in bytes. The newest of each is always kept.
const MOST_BYTES: usize = 512 << 20;
/// Largest number of cached cameras of a topic.
const CAMERAS: usize = 16;
/// Largest number of cached stamps of clouds and cameras.
const STAMPS: usize = 8;
/// Duration of cached transforms in nanoseconds, as in tf2.
const TRANSFORMS: u64 = 10_000_000_000;
/// Stamps that go back by more nanoseconds mean that a clock was set back, or a recording was restarted. Smaller steps are
/// messages out of order.
const JUMP: i64 = 1_000_000_000;
/// Largest size of a message, in bytes. The largest that robots send, images of 50 megapixels, have 150 million.
const LARGEST: usize = 256 << 20;

/// When a message was received.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Receipt {
    /// Time of a monotonic clock.
    pub at: Duration,
    /// Nanoseconds since 1970, for messages without a stamp.
    pub stamp: Timestamp,
}

/// Assembles the frames of a running robot, as [`Frames`](super::Frames) does for a recording, message by message.
///
/// Each image is returned once: as a frame, or with the reason why it was dropped. Memory is bounded for any input.
///
/// ```
/// # fn main() -> lsdc_files::error::Result<()> {
/// use lsdc_recordings::{FrameOptions, FrameTopics, LiveFrames, MessageType, Receipt};
/// use std::time::Duration;
///
/// let topics = FrameTopics {
///     image: ("/camera/image_raw".to_owned(), MessageType::Image),
///     points: ("/lidar/points".to_owned(), MessageType::PointCloud2),
///     camera_info: Some("/camera/camera_info".to_owned()),
///     depth_info: None,
///     tf: vec!["/tf".to_owned(), "/tf_static".to_owned()],
/// };
/// let mut live = LiveFrames::new(topics, &FrameOptions::default(), Duration::from_millis(200));
/// let receipt = Receipt { at: Duration::ZERO, stamp: 0 };
/// live.add("/camera/image_raw", b"no image".to_vec(), receipt);
/// let found = live.next(receipt.at).unwrap();
/// assert_eq!(found.err().unwrap().reason.kind(), "damaged");
/// # Ok(())
/// # }
/// ```
pub struct LiveFrames {
    rig: Rig,
    tolerance: Duration,
    patience: Duration,
    /// Waiting images, in order of arrival.
    images: VecDeque<WaitingImage>,
    clouds: TimeSeries<Cloud>,
    /// Stamps of the last clouds and, below, of the last camera messages, in order of arrival.
    cloud_stamps: VecDeque<Timestamp>,
    camera_stamps: VecDeque<Timestamp>,
    /// Whether the last image had a camera message with the same stamp.
    has_own_camera: bool,
    newest_image: Option<Timestamp>,
    /// Whether frames have the pose of their camera and, below, the route to it, if transforms lead there.
    has_poses: bool,
    camera_route: Option<Route>,
    /// Whether something was added since the rig was last settled.
    changed: bool,
    /// Why the rig could not be settled.
    lacking: Option<String>,
    remarks: Vec<String>,
    dropped: VecDeque<DroppedFrame>,
    counts: LiveCounts,
}

/// Numbers of messages that were received, left out or adjusted, unless stated otherwise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LiveCounts {
    /// Images received. Each is returned or still waits.
    pub images: u64,
    /// Points messages received.
    pub points: u64,
    /// Damaged points messages.
    pub damaged_points: u64,
    /// Messages without a usable camera.
    pub unusable_cameras: u64,
    /// Damaged or invalid transforms, counted one by one; a damaged message counts once.
    pub unusable_transforms: u64,
    /// Transforms of a frame that had another parent before.
    pub reparented: u64,
    /// Static transforms that differ from the previous ones.
    pub replaced: u64,
    /// Transforms of frames beyond the limit.
    pub crowded: u64,
    /// Messages without a stamp, for which the time of receipt is used.
    pub unstamped: u64,
    /// How often a clock was set back, by the stamps of messages.
    pub set_back: u64,
    /// Messages above the size limit.
    pub too_large: u64,
}

struct WaitingImage {
    header: Header,
    message: Vec<u8>,
    received: Duration,
    /// Stamp of its points, and the time of the last of them, once known.
    points_end: Option<(Timestamp, Timestamp)>,
}

/// Message of points, and the times of image and points.
type MatchedPoints = (Arc<Vec<u8>>, FrameTimes);

struct Cloud {
    frame: String,
    message: Arc<Vec<u8>>,
}

/// An image and its points, with everything needed to decode them on any thread.
pub struct LiveFrame {
    header: Header,
    times: FrameTimes,
    received: Duration,
    image: Vec<u8>,
    points: Arc<Vec<u8>>,
    pose: Option<CameraPose>,
    rig: Rig,
}

impl LiveFrame {
    /// Returns the stamp of the image and its frame of reference.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// Returns when the image was received.
    pub fn received(&self) -> Duration {
        self.received
    }

    /// Returns the stamp of its points. It identifies the cloud: no two cached clouds have the same stamp.
    pub fn points_stamp(&self) -> Timestamp {
        self.times.points
    }

    /// Returns the pose of the camera; `None` without [`LiveFrames::with_poses`], or if it is not known from the
    /// transforms.
    pub fn pose(&self) -> Option<&CameraPose> {
        self.pose.as_ref()
    }

    /// Decodes the frame. The result equals that from a recording of the messages.
    ///
    /// # Errors
    /// A message is damaged, the camera is of images of another shape, or no points are in the image.
    pub fn decode(&self) -> Result<DecodedFrame> {
        self.rig.decode(self.times, [&self.image, &self.points])
    }

    /// Returns the camera of the image as a message of `sensor_msgs/msg/CameraInfo` with the header of the image; `None` if
    /// no topic describes it or a camera was given.
    pub fn camera_info(&self) -> Option<Vec<u8>> {
        if self.rig.given_camera.is_some() {
            return None;
        }
        let message = self.rig.cameras.message(self.times.image)?;
        // The message has been read successfully before.
        restamped_camera_info(message, &self.header).ok()
    }
}

impl LiveFrames {
    /// Assembles frames of these topics. An image waits for its points and for transforms until `patience` after its
    /// receipt. The names of topics in `options` are not used.
    pub fn new(topics: FrameTopics, options: &FrameOptions, patience: Duration) -> Self {
        Self {
            rig: Rig::new(topics, options, Transforms::of_the_last(TRANSFORMS)),
            tolerance: options.tolerance,
            patience,
            images: VecDeque::new(),
            clouds: TimeSeries::default(),
            cloud_stamps: VecDeque::new(),
            camera_stamps: VecDeque::new(),
            has_own_camera: false,
            newest_image: None,
            has_poses: false,
            camera_route: None,
            changed: true,
            lacking: None,
            remarks: Vec::new(),
            dropped: VecDeque::new(),
            counts: LiveCounts::default(),
        }
    }

    /// Adds the pose of the camera to each frame. An image then also waits for the transforms of its own time.
    #[must_use]
    pub fn with_poses(self) -> Self {
        Self {
            has_poses: true,
            ..self
        }
    }

    /// Adds a message. Messages of unknown topics are ignored.
    pub fn add(&mut self, topic: &str, message: Vec<u8>, receipt: Receipt) {
        let topics = &self.rig.topics;
        let [is_image, is_points] = [&topics.image.0, &topics.points.0].map(|name| name == topic);
        if message.len() > LARGEST {
            self.counts.too_large += 1;
            if is_image {
                let what = format!("it has {} bytes, more than are read", message.len());
                self.counts.images += 1;
                self.drop_image(receipt.stamp, DropReason::Damaged(what));
            }
        } else if is_image {
            self.add_image(message, receipt);
        } else if is_points {
            self.add_points(message, receipt);
        } else {
            self.add_other(topic, &message);
        }
    }

    fn add_image(&mut self, message: Vec<u8>, receipt: Receipt) {
        self.counts.images += 1;
        let header = match Header::of(&message) {
            Ok(header) => self.stamped(header, receipt),
            Err(error) => {
                return self.drop_image(receipt.stamp, DropReason::Damaged(error.with_causes()));
            }
        };
        self.watch_clock(self.newest_image, header.stamp);
        self.newest_image = self.newest_image.max(Some(header.stamp));
        self.images.push_back(WaitingImage {
            header,
            message,
            received: receipt.at,
            points_end: None,
        });
        let sizes = self.images.iter().rev().map(|image| image.message.len());
        let kept = fitting(sizes).min(IMAGES);
        let superseded = self.images.len() - kept;
        let superseded: Vec<_> = self.images.drain(..superseded).collect();
        for image in superseded {
            self.drop_image(image.header.stamp, DropReason::Superseded);
        }
    }

    fn add_points(&mut self, message: Vec<u8>, receipt: Receipt) {
        self.counts.points += 1;
        let Ok(header) = Header::of(&message) else {
            self.counts.damaged_points += 1;
            return;
        };
        let header = self.stamped(header, receipt);
        let newest = self.clouds.last().map(|(stamp, _)| *stamp);
        self.watch_clock(newest, header.stamp);
        self.changed |= self.rig.add_times(&message, header.stamp);
        keep(&mut self.cloud_stamps, header.stamp);
        let cloud = Cloud {
            frame: header.frame,
            message: Arc::new(message),
        };
        self.clouds.insert(header.stamp, cloud);
        let sizes = self
            .clouds
            .iter()
            .rev()
            .map(|(_, cloud)| cloud.message.len());
        let kept = fitting(sizes).min(CLOUDS);
        self.clouds.keep_last(kept);
    }

    fn add_other(&mut self, topic: &str, message: &[u8]) {
        if self.rig.topics.camera_info.as_deref() == Some(topic)
            && let Ok(header) = Header::of(message)
        {
            keep(&mut self.camera_stamps, header.stamp);
        }
        self.changed |= self.rig.add(topic, message);
        self.rig.cameras.keep_last(CAMERAS);
        self.rig.depth_cameras.keep_last(CAMERAS);
    }

    /// Replaces a missing stamp by the time of receipt.
    fn stamped(&mut self, header: Header, receipt: Receipt) -> Header {
        if header.stamp != 0 {
            return header;
        }
        self.counts.unstamped += 1;
        let stamp = receipt.stamp;
        Header { stamp, ..header }
    }

    /// Restarts if the clock of images or points was set back.
    fn watch_clock(&mut self, newest: Option<Timestamp>, stamp: Timestamp) {
        if newest.is_none_or(|newest| newest.saturating_sub(stamp) <= JUMP) {
            return;
        }
        self.counts.set_back += 1;
        for image in std::mem::take(&mut self.images) {
            self.drop_image(image.header.stamp, DropReason::ClockSetBack);
        }
        self.clouds = TimeSeries::default();
        self.cloud_stamps.clear();
        self.camera_stamps.clear();
        self.newest_image = None;
        self.rig.transforms.forget_motion();
        self.rig.cameras.forget_times();
        self.rig.depth_cameras.forget_times();
        self.changed = true;
    }

    fn drop_image(&mut self, stamp: Timestamp, reason: DropReason) {
        self.dropped.push_back(DroppedFrame { stamp, reason });
    }

    /// Returns the next image that is ready or dropped, in order of receipt. Call it after adding messages and at the
    /// [deadline](Self::deadline), until it returns `None`.
    pub fn next(&mut self, now: Duration) -> Option<std::result::Result<LiveFrame, DroppedFrame>> {
        if let Some(dropped) = self.dropped.pop_front() {
            return Some(Err(dropped));
        }
        let mut image = self.images.pop_front()?;
        let stamp = image.header.stamp;
        let is_last_chance = now >= image.received.saturating_add(self.patience);
        let Some(decided) = self.decide(&mut image, is_last_chance) else {
            self.images.push_front(image);
            return None;
        };
        self.has_own_camera = self.camera_stamps.contains(&stamp);
        let first_needed = self.images.front().map_or(stamp, |next| next.header.stamp);
        let tolerance = i64::try_from(self.tolerance.as_nanos()).unwrap_or(i64::MAX);
        self.clouds
            .forget_before(first_needed.saturating_sub(tolerance));
        let found = decided.and_then(|(points, times)| {
            let rig = self.rig.snapshot();
            rig.motion(times.points, times.image)?;
            let route = self.camera_route.as_ref();
            let pose = route.and_then(|route| self.rig.camera_pose(route, stamp));
            Ok(LiveFrame {
                pose,
                header: image.header,
                times,
                received: image.received,
                image: image.message,
                points,
                rig,
            })
        });
        Some(found.map_err(|reason| DroppedFrame { stamp, reason }))
    }

    /// Returns the points of an image, or why it has none; `None` while it waits.
    fn decide(
        &mut self,
        image: &mut WaitingImage,
        is_last_chance: bool,
    ) -> Option<std::result::Result<MatchedPoints, DropReason>> {
        let stamp = image.header.stamp;
        if !is_last_chance && !self.has_nearest(stamp) {
            return None;
        }
        let Some((time, cloud)) = self.clouds.nearest(stamp) else {
            return Some(Err(DropReason::NoPoints(None)));
        };
        let time = *time;
        let distance = time.abs_diff(stamp);
        if u128::from(distance) > self.tolerance.as_nanos() {
            return Some(Err(DropReason::NoPoints(Some(distance))));
        }
        let (frame, message) = (cloud.frame.clone(), cloud.message.clone());
        let times = FrameTimes {
            image: stamp,
            points: time,
        };
        self.settle([image.header.frame.clone(), frame], stamp);
        if let Some(lacking) = &self.lacking {
            let reason = || Err(DropReason::NotReady(lacking.clone()));
            return is_last_chance.then(reason);
        }
        if !is_last_chance {
            let newest_camera = self.camera_stamps.iter().max();
            if self.has_own_camera && newest_camera.is_some_and(|newest| *newest < stamp) {
                return None;
            }
            let end = match image.points_end {
                Some((points, end)) if points == time => end,
                _ => {
                    let end = self.rig.points_end(time, &message);
                    image.points_end = Some((time, end));
                    end
                }
            };
            let transforms = &self.rig.transforms;
            let reach = |route| {
                [time, end]
                    .into_iter()
                    .all(|points| transforms.reach(route, [points, stamp]))
            };
            let is_placed = |route| transforms.reach(route, [stamp; 2]);
            if !self.rig.route.as_ref().is_none_or(reach)
                || !self.camera_route.as_ref().is_none_or(is_placed)
            {
                return None;
            }
        }
        Some(Ok((message, times)))
    }

    /// Whether the cloud nearest to a time has arrived: one after it has, or the next one is expected to be further away
    /// than the last.
    fn has_nearest(&self, stamp: Timestamp) -> bool {
        let Some((newest, _)) = self.clouds.last() else {
            return false;
        };
        let past = stamp.saturating_sub(*newest);
        past <= 0
            || self
                .shortest_interval()
                .is_some_and(|interval| interval.saturating_sub(past) >= past)
    }

    /// Returns the time, in nanoseconds, in which no further cloud is expected: 90 % of the shortest interval between the
    /// last ones.
    fn shortest_interval(&self) -> Option<i64> {
        const LEAST: usize = 3;
        let (earlier, later) = (self.cloud_stamps.iter(), self.cloud_stamps.iter().skip(1));
        let intervals = earlier.zip(later).map(|(a, b)| b.saturating_sub(*a));
        let shortest = intervals
            .min()
            .filter(|_| self.cloud_stamps.len() > LEAST)?;
        Some(shortest / 10 * 9)
    }

    /// Settles the rig if anything has changed, or if image and points have other frames of reference than before.
    fn settle(&mut self, frames: [String; 2], stamp: Timestamp) {
        if !self.changed && self.rig.frames.as_ref() == Some(&frames) {
            return;
        }
        self.rig.frames = Some(frames);
        self.changed = false;
        self.camera_route = None;
        match self.rig.settle(stamp) {
            Ok(remarks) => (self.remarks, self.lacking) = (remarks, None),
            Err(error) => {
                self.lacking = Some(error.to_string());
                return;
            }
        }
        if self.has_poses {
            match self.rig.camera_route() {
                Ok(route) => self.camera_route = Some(route),
                Err(error) => self.remarks.push(format!(
                    "it is not known where the camera was, and points of earlier images are not used: {error}"
                )),
            }
        }
    }

    /// Latest time at which the oldest waiting image is returned.
    pub fn deadline(&self) -> Option<Duration> {
        let first = self.images.front()?;
        Some(first.received.saturating_add(self.patience))
    }

    /// Number of images that wait for points or transforms.
    pub fn waiting(&self) -> usize {
        self.images.len()
    }

    /// Returns why no image can be completed yet: a missing camera or missing transforms.
    pub fn lacking(&self) -> Option<&str> {
        self.lacking.as_deref()
    }

    /// Assumptions that should be checked, a sentence each.
    pub fn remarks(&self) -> &[String] {
        &self.remarks
    }

    /// Counts so far.
    pub fn counts(&self) -> LiveCounts {
        let Rig {
            cameras,
            depth_cameras,
            transforms,
            unusable_transforms,
            ..
        } = &self.rig;
        LiveCounts {
            unusable_cameras: (cameras.unusable + depth_cameras.unusable) as u64,
            unusable_transforms: *unusable_transforms as u64,
            reparented: transforms.reparented as u64,
            replaced: transforms.replaced as u64,
            crowded: transforms.crowded as u64,
            set_back: self.counts.set_back + transforms.jumps as u64,
            ..self.counts
        }
    }
}

impl Rig {
    /// Returns the time of the last point of a message; its stamp if points have no times.
    fn points_end(&self, stamp: Timestamp, message: &[u8]) -> Timestamp {
        let cloud = self.point_times.as_ref().map(|_| PointCloud::of(message));
        let sweep = cloud.and_then(|cloud| self.sweep(stamp, &cloud.ok()?));
        sweep.map_or(stamp, Sweep::end)
    }
}

/// Returns how many messages of these sizes fit in the memory limit; at least one.
fn fitting(sizes: impl Iterator<Item = usize>) -> usize {
    let mut bytes = 0;
    let fits = |size: &usize| {
        bytes += size;
        bytes <= MOST_BYTES
    };
    sizes.take_while(fits).count().max(1)
}

/// Appends a stamp, and drops the oldest.
fn keep(stamps: &mut VecDeque<Timestamp>, stamp: Timestamp) {
    if stamps.len() == STAMPS {
        stamps.pop_front();
    }
    stamps.push_back(stamp);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_messages_are_kept_within_their_bytes() {
        assert_eq!(fitting([1 << 20; 9].into_iter()), 9);
        assert_eq!(fitting([200 << 20; 9].into_iter()), 2);
        assert_eq!(fitting([MOST_BYTES + 1, 1].into_iter()), 1);
    }
}
