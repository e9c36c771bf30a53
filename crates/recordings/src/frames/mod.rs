//! The frames of a recording: each image with the points nearest in time.

mod cameras;
mod choice;
mod decoded;
mod live;
mod options;
mod poses;
mod rig;
mod stamps;
mod sweep;

pub use choice::FrameTopics;
pub use decoded::{DecodedFrame, DecodedPoints, FrameMessages};
pub use live::{LiveCounts, LiveFrame, LiveFrames, Receipt};
pub use options::FrameOptions;
pub use poses::{CameraPose, NEIGHBOUR_WINDOW};
pub use sweep::PointTimes;
pub(crate) use sweep::timed;

use crate::container::{MessageLocation, MessageTimes};
use crate::message::{Header, Timestamp};
use crate::series::TimeSeries;
use crate::transforms::{Route, TransformGap, Transforms};
use crate::{Defects, Recording};
use choice::is_rectified;
use lsdc_files::error::Result;
use rig::Rig;
use std::time::Duration;

/// The frames of a recording. Every image is either in `found` or in `dropped`.
pub struct Frames {
    /// Frames, in the order of the recording.
    pub found: Vec<SyncedFrame>,
    /// Images that cannot be used, in the order of the recording.
    pub dropped: Vec<DroppedFrame>,
    /// Assumptions and omissions that should be checked, a sentence each.
    pub remarks: Vec<String>,
    rig: Rig,
}

/// An image and the points nearest to it in time.
#[derive(Clone, Debug)]
pub struct SyncedFrame {
    /// When the image was taken.
    pub stamp: Timestamp,
    /// Location of the image in the recording.
    pub location: MessageLocation,
    /// When the image was recorded and published, in nanoseconds.
    pub times: MessageTimes,
    /// Location of the points in the recording. Images taken in quick succession share their points.
    pub points: MessageLocation,
    /// When the points were measured.
    pub points_stamp: Timestamp,
}

/// An image that cannot be used.
#[derive(Clone, Debug)]
pub struct DroppedFrame {
    /// When the image was taken.
    pub stamp: Timestamp,
    /// Why it cannot be used.
    pub reason: DropReason,
}

/// Why an image cannot be used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum DropReason {
    /// The nearest points are this many nanoseconds away; `None` if there are no points.
    NoPoints(Option<u64>),
    /// The transform from the points to the camera is not known.
    NoTransform(TransformGap),
    /// The frame of reference differs from that of the first image, or of the first points.
    OtherFrame(String),
    /// The message is damaged.
    Damaged(String),
    /// On a running robot: the camera, or transforms from the points to the camera, have not arrived yet.
    NotReady(String),
    /// On a running robot: a newer image arrived before this one was used.
    Superseded,
    /// On a running robot: its clock was set back while the image waited.
    ClockSetBack,
}

impl DropReason {
    /// Returns the kind of reason, for counting.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::NoPoints(_) => "without points near their time",
            Self::NoTransform(gap) => gap.kind(),
            Self::OtherFrame(_) => "of another frame of reference",
            Self::Damaged(_) => "damaged",
            Self::NotReady(_) => "before camera and transforms are known",
            Self::Superseded => "superseded by a newer image",
            Self::ClockSetBack => "from before the clock was set back",
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
            Self::Damaged(what) | Self::NotReady(what) => write!(f, "{what}"),
            Self::Superseded => write!(f, "a newer image came before it was used"),
            Self::ClockSetBack => write!(f, "the clock was set back while it waited"),
        }
    }
}

/// A message with its times.
#[derive(Clone, Debug)]
struct TimedMessage {
    location: MessageLocation,
    times: MessageTimes,
    /// The frame of reference, if it differs from the first one.
    other_frame: Option<String>,
}

/// The messages of a topic, collected in one pass over a recording.
#[derive(Default)]
struct TopicMessages {
    found: Vec<(Timestamp, TimedMessage)>,
    /// Frame of reference of the first message.
    frame: Option<String>,
    damaged: Vec<DroppedFrame>,
    /// Number of messages without a stamp, for which the time of recording is used.
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
    /// Finds the frames of a recording in one pass, which skips topics that are not needed.
    ///
    /// # Errors
    /// Topics do not exist or have another type, a camera or transforms are missing, or the recording cannot be read.
    pub fn of(recording: &mut Recording, options: &FrameOptions) -> Result<Self> {
        let topics = FrameTopics::choose(recording, options)?;
        let mut rig = Rig::new(topics.clone(), options, Transforms::default());
        let (mut images, mut points) = (TopicMessages::default(), TopicMessages::default());
        let defects =
            recording.visit(&|topic| topics.has(&topic.name), &mut |topic, message| {
                let name = topic.name.as_str();
                if name == topics.image.0 {
                    images.add(message);
                }
                if name == topics.points.0 {
                    points.add(message);
                    if let Some((stamp, _)) = points.found.last() {
                        rig.add_times(message.data, *stamp);
                    }
                }
                rig.add(name, message.data);
                Ok(())
            })?;
        let unusable = [
            (
                rig.cameras.unusable + rig.depth_cameras.unusable,
                "messages of cameras cannot be used and are left out",
            ),
            (
                rig.unusable_transforms,
                "transforms are damaged and left out",
            ),
        ];
        let mut remarks = remarks(&defects, [&images, &points], &unusable, &rig.transforms);
        rig.frames = images
            .frame
            .clone()
            .zip(points.frame.clone())
            .map(Into::into);
        let stamp = images.found.first().map_or(0, |(stamp, _)| *stamp);
        remarks.extend(rig.settle(stamp)?);
        let mut frames = Self {
            found: Vec::new(),
            dropped: std::mem::take(&mut images.damaged),
            remarks,
            rig,
        };
        frames.pair(images, points, options.tolerance);
        Ok(frames)
    }

    /// Returns the topics that the frames are made of.
    pub fn topics(&self) -> &FrameTopics {
        &self.rig.topics
    }

    /// Returns the times of the points, if motion within a cloud is compensated.
    pub fn point_times(&self) -> Option<&PointTimes> {
        self.rig.point_times.as_ref()
    }

    /// Returns the topic of the camera and the parameters in use: K and D for unrectified images, P for rectified ones.
    /// `None` if no topic describes the camera.
    pub fn seen_by(&self) -> Option<String> {
        let FrameTopics {
            image, camera_info, ..
        } = &self.rig.topics;
        if self.rig.given_camera.is_some() {
            return Some("given, in the frame of the points".to_owned());
        }
        let topic = camera_info
            .as_ref()
            .filter(|_| !self.rig.cameras.is_empty())?;
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

    /// Whether points are clouds, whose points have a single time unless they are deskewed.
    pub fn has_clouds(&self) -> bool {
        self.rig.has_clouds()
    }

    /// Pairs each image with the points nearest in time.
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
        self.rig.motion(*time, stamp)?;
        Ok(SyncedFrame {
            stamp,
            location: image.location,
            times: image.times,
            points: cloud.location,
            points_stamp: *time,
        })
    }

    /// Describes the source of the frames as text: recordings with equal texts give the same frames.
    pub fn about(&self) -> String {
        let FrameTopics {
            image,
            points,
            camera_info,
            tf,
            ..
        } = &self.rig.topics;
        let camera = camera_info.as_deref().unwrap_or("none");
        let fixed = self.rig.route.as_ref().map_or("none", Route::fixed);
        let times = self.point_times().map_or("none", |found| &found.field);
        format!(
            "{} with {}, camera {camera}, transforms {}, motion in {fixed}, times {times}",
            image.0,
            points.0,
            tf.join(" ")
        )
    }
}

/// Returns the remarks about a recording.
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
