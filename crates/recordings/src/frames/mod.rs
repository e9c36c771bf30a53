//! The frames of a recording: each image with the points that are nearest in time.

mod cameras;
mod choice;
mod loaded;
mod stamps;
mod sweep;
mod wanted;

pub use loaded::{Loaded, Stored};
pub use sweep::Deskewed;
pub(crate) use sweep::timed;
pub use wanted::Wanted;

use crate::container::Place;
use crate::message::{Header, Kind, Points, Stamp, transforms};
use crate::series::Series;
use crate::transforms::{Gap, Route, Transforms};
use crate::{Flaws, Recording};
use cameras::{Cameras, apart};
use choice::{Topics, is_rectified};
use lsdc_files::error::{Error, Result};
use lsdc_files::{Camera, Unit};
use std::time::Duration;
use sweep::Trial;

/// The frames of a recording. As many images as there are messages are either found or dropped.
pub struct Frames {
    topics: Topics,
    /// In the order of the recording.
    pub found: Vec<Frame>,
    /// Images that cannot be used, in the order of the recording.
    pub dropped: Vec<Dropped>,
    /// What was assumed or left out and should be checked, a sentence each.
    pub remarks: Vec<String>,
    unit: Option<Unit>,
    given: Option<Camera>,
    cameras: Cameras,
    /// Of images of depths.
    depth_cameras: Cameras,
    /// Whether images of depths are of the pixels of the image.
    registered: bool,
    transforms: Transforms,
    /// From the points to the camera, unless that is given.
    route: Option<Route>,
    /// How points have times of their own by which they are seen, if they have.
    deskewed: Option<Deskewed>,
}

/// An image and its points.
#[derive(Clone, Debug)]
pub struct Frame {
    /// When the image was taken.
    pub stamp: Stamp,
    /// Where the image is in the recording.
    pub place: Place,
    /// When the image was recorded and published, in nanoseconds.
    pub times: crate::Times,
    points: Place,
    /// When the points were measured.
    points_stamp: Stamp,
}

/// An image that cannot be used.
#[derive(Clone, Debug)]
pub struct Dropped {
    /// When it was taken.
    pub stamp: Stamp,
    /// Why it cannot be used.
    pub reason: Reason,
}

/// Why an image cannot be used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reason {
    /// The nearest points are so many nanoseconds away, if there are any.
    NoPoints(Option<u64>),
    /// It is not known where camera and points were.
    NoTransform(Gap),
    /// It is of another frame of reference than the first image, or its points than the first points.
    OtherFrame(String),
    /// The message is damaged.
    Damaged(String),
}

impl Reason {
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

impl std::fmt::Display for Reason {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::NoPoints(None) => write!(f, "there are no points"),
            Self::NoPoints(Some(away)) => {
                write!(
                    f,
                    "the nearest points are {:.3} s away",
                    *away as f64 * 1e-9
                )
            }
            Self::NoTransform(gap) => write!(f, "{gap}"),
            Self::OtherFrame(frame) => write!(f, "it, or its points, are in the frame `{frame}`"),
            Self::Damaged(what) => write!(f, "{what}"),
        }
    }
}

/// A message that something was measured in.
#[derive(Clone, Debug)]
struct Measured {
    place: Place,
    times: crate::Times,
    /// The frame of reference, if it is not that of the first.
    other_frame: Option<String>,
}

/// What a pass over a recording collects of a topic.
#[derive(Default)]
struct Collected {
    found: Vec<(Stamp, Measured)>,
    /// The frame of reference of the first.
    frame: Option<String>,
    damaged: Vec<Dropped>,
    /// Messages without a stamp, which are taken at the time that they were recorded.
    unstamped: usize,
}

impl Collected {
    fn add(&mut self, message: &crate::Message<'_>) {
        let times = crate::Times {
            log: message.log_time,
            publish: message.publish_time,
        };
        let recorded = i64::try_from(message.log_time).unwrap_or(0);
        let header = match Header::of(message.data) {
            Ok(header) => header,
            Err(error) => {
                self.damaged.push(Dropped {
                    stamp: recorded,
                    reason: Reason::Damaged(error.with_causes()),
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
        let measured = Measured {
            place: message.place,
            times,
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
    pub fn of(recording: &mut Recording, wanted: &Wanted) -> Result<Self> {
        let topics = Topics::choose(recording, wanted)?;
        let (mut images, mut points) = (Collected::default(), Collected::default());
        let [mut cameras, mut depth_cameras] = [&topics.image.0, &topics.points.0]
            .map(|topic| cameras::Collected::new(is_rectified(topic)));
        let mut tree = Transforms::default();
        let mut unusable = 0;
        let deskew = wanted.deskew && topics.points.1 == Kind::PointCloud2;
        let mut trial = Trial::default();
        let flaws = recording.visit(&|topic| topics.has(&topic.name), &mut |topic, message| {
            let name = topic.name.as_str();
            if name == topics.image.0 {
                images.add(message);
            }
            if name == topics.points.0 {
                points.add(message);
                if let (true, Some((stamp, _))) = (deskew, points.found.last()) {
                    // What is damaged is said where it is needed.
                    let _ = Points::of(message.data).map(|cloud| trial.add(&cloud, *stamp));
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
                    Ok((found, bad)) => {
                        unusable += bad;
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
        let bad = cameras.bad.take().or(depth_cameras.bad.take());
        let mut frames = Self {
            found: Vec::new(),
            dropped: std::mem::take(&mut images.damaged),
            remarks: remarks(&flaws, [&images, &points], &unusable, &tree),
            unit: wanted.unit,
            given: wanted.camera.clone(),
            cameras: cameras.cameras(),
            depth_cameras: depth_cameras.cameras(),
            registered: false,
            transforms: tree,
            route: None,
            deskewed: None,
            topics,
        };
        frames.see([&images, &points]);
        frames.route = frames.routed([&images, &points], wanted, bad)?;
        frames.deskew(trial);
        frames.pair(images, points, wanted.tolerance);
        Ok(frames)
    }

    /// How points have times of their own by which they are seen, if they have.
    pub fn deskewed(&self) -> Option<&Deskewed> {
        self.deskewed.as_ref()
    }

    /// The camera of the images, and what of it holds: of unrectified images K and D, of rectified ones P. Nothing if no
    /// topic has one.
    pub fn seen_by(&self) -> Option<String> {
        let Topics {
            image, camera_info, ..
        } = &self.topics;
        if self.given.is_some() {
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
        self.topics.points.1 == Kind::PointCloud2
    }

    /// Whether points are images of depths.
    fn has_maps(&self) -> bool {
        !self.has_clouds()
    }

    /// Places cameras in their frames, decides whether depths are of the pixels of the image, and remarks what that assumes.
    fn see(&mut self, [images, points]: [&Collected; 2]) {
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
                .extend(cameras.place(topic, frame, stamp, &self.transforms));
            if let Some(own) = cameras.frame.as_ref().filter(|own| *own != frame) {
                self.remarks.push(format!(
                    "`{topic}` is in the frame `{own}`, but its images are in `{frame}`, which is used"
                ));
            }
        }
        let same = image == cloud && self.given.is_none();
        if same && image.is_empty() {
            self.remarks.push(
                "the messages name no frame of reference: the points are taken to be in that of the camera".to_owned(),
            );
        }
        if self.has_clouds() || !same && self.given.is_none() {
            return;
        }
        let why = if self.given.is_some() {
            "the camera is given".to_owned()
        } else {
            format!("both are in the frame `{image}`")
        };
        let camera = self.given.clone().or_else(|| self.cameras.at(stamp));
        let remark = match (camera, self.depth_cameras.at(stamp)) {
            (Some(camera), Some(depths)) => {
                let pixels = apart(&depths, &camera);
                self.registered = pixels <= NEAR;
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

    /// Sees points by their own times, or remarks why they are not, though they have some.
    fn deskew(&mut self, trial: Trial) {
        let route = self.route.as_ref();
        let moves = route.is_some_and(|route| self.transforms.move_on(route));
        let why = match trial.found() {
            Ok(Some(found)) if moves => {
                self.deskewed = Some(found);
                return;
            }
            Ok(None) => return,
            Ok(Some(Deskewed { field, .. })) => format!(
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

    /// The way from the points to the camera, unless the camera is given or its own depths are the points.
    /// `bad` is what is wrong with the first camera that is none.
    fn routed(
        &self,
        [images, points]: [&Collected; 2],
        wanted: &Wanted,
        bad: Option<Error>,
    ) -> Result<Option<Route>> {
        let (Some(image), Some(cloud)) = (&images.frame, &points.frame) else {
            return Ok(None);
        };
        // What was in one frame stays there, whatever time has passed.
        if self.given.is_some() || self.has_maps() && image == cloud {
            return Ok(None);
        }
        self.topics
            .check_cameras(self.cameras.is_empty(), self.depth_cameras.is_empty())
            .map_err(|missing| match (bad, missing.advice()) {
                (Some(bad), Some(hint)) => bad.hint(hint),
                _ => missing,
            })?;
        self.transforms
            .route(cloud, image, wanted.fixed.as_deref())
            .map(Some)
    }

    /// Gives each image the points that are nearest in time.
    fn pair(&mut self, images: Collected, points: Collected, tolerance: Duration) {
        let clouds = Series::new(points.found);
        for (stamp, image) in images.found {
            let found = self.paired(stamp, &image, &clouds, tolerance);
            match found {
                Ok(frame) => self.found.push(frame),
                Err(reason) => self.dropped.push(Dropped { stamp, reason }),
            }
        }
    }

    fn paired(
        &self,
        stamp: Stamp,
        image: &Measured,
        clouds: &Series<Measured>,
        tolerance: Duration,
    ) -> std::result::Result<Frame, Reason> {
        let (time, cloud) = clouds.nearest(stamp).ok_or(Reason::NoPoints(None))?;
        let away = time.abs_diff(stamp);
        if u128::from(away) > tolerance.as_nanos() {
            return Err(Reason::NoPoints(Some(away)));
        }
        if let Some(frame) = image.other_frame.as_ref().or(cloud.other_frame.as_ref()) {
            return Err(Reason::OtherFrame(frame.clone()));
        }
        if let Some(route) = &self.route {
            let moved = self.transforms.between(route, [*time, stamp]);
            moved.map_err(Reason::NoTransform)?;
        }
        Ok(Frame {
            stamp,
            place: image.place,
            times: image.times,
            points: cloud.place,
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
        let times = self.deskewed.as_ref().map_or("none", |found| &found.field);
        format!(
            "{} with {}, camera {camera}, transforms {}, motion in {fixed}, times {times}",
            image.0,
            points.0,
            tf.join(" ")
        )
    }
}

/// Cameras that see the same place so many pixels apart are one.
const NEAR: f64 = 1.0;

/// What should be said of a recording.
fn remarks(
    flaws: &Flaws,
    [images, points]: [&Collected; 2],
    unusable: &[(usize, &str)],
    tree: &Transforms,
) -> Vec<String> {
    let mut remarks: Vec<String> = flaws.lines().collect();
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
            tree.elsewhere,
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
