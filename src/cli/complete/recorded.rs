//! Frames of a recording.

use super::loaded::Loaded;
use super::settings::Settings;
use crate::cli::args::Complete;
use crate::cli::ui;
use lsdc_core::Observations;
use lsdc_eval::data::{Camera, check_foreign};
use lsdc_files::error::{Error, Result};
use lsdc_recordings::{
    DecodedPoints, DroppedFrame, FrameMessages, FrameOptions, Frames, Header, PointTimes,
    Recording, Rigid, Route, SyncedFrame, TransformGap,
};
use lsdc_weights::provenance;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// A recording and its frames.
pub(super) struct Recorded {
    path: PathBuf,
    frames: Frames,
    recording: Mutex<Recording>,
}

impl Recorded {
    /// Finds the frames of the recording that is named, and says what cannot be used of it.
    pub(super) fn open(settings: &Settings) -> Result<Self> {
        let topics = &settings.recording;
        let path = settings.sparse.clone();
        let mut recording = Recording::open(&path)?;
        let wanted = FrameOptions {
            image: topics.image.clone(),
            points: topics.points.clone(),
            camera_info: topics.camera_info.clone(),
            tf: topics.tf.clone(),
            fixed: topics.fixed_frame.clone(),
            tolerance: Duration::from_secs_f64(topics.tolerance),
            camera: settings.camera.clone(),
            unit: settings.depth_unit,
            deskew: !topics.no_deskew,
        };
        let frames = Frames::of(&mut recording, &wanted)?;
        for remark in &frames.remarks {
            ui::warn(&format!("warning: {remark}"));
        }
        if frames.found.is_empty() {
            return Err(match frames.dropped.first() {
                None => Error::format(&path, "has no message of the topic of images"),
                Some(DroppedFrame { stamp, reason }) => {
                    let count = frames.dropped.len();
                    let what = format!(
                        "none of the {count} images can be completed; the first, {stamp}: {reason}"
                    );
                    Error::format(&path, what)
                        .hint("check topics and stamps by `lsdc inspect`; --tolerance allows for more time between")
                }
            });
        }
        Ok(Self {
            path,
            frames,
            recording: Mutex::new(recording),
        })
    }

    /// Says how many images there are, and which of them are left out, and why.
    pub(super) fn tell(&self, json: bool) {
        let Frames { found, dropped, .. } = &self.frames;
        let tell = if json { ui::say } else { ui::tell };
        tell(&format!(
            "recording {} images: {} with points, {} left out",
            found.len() + dropped.len(),
            found.len(),
            dropped.len()
        ));
        if let Some(camera) = self.frames.seen_by() {
            tell(&format!("camera    {camera}"));
        }
        match self.frames.point_times() {
            Some(PointTimes { field, seconds, .. }) => tell(&format!(
                "deskewed  each point counts at its own time: `{field}`, {seconds:.4} s from the first of a cloud to the last"
            )),
            None if self.frames.has_clouds() => {
                tell("deskewed  no: all points of a cloud count at its stamp");
            }
            None => {}
        }
        let mut kinds: Vec<&str> = dropped
            .iter()
            .map(|dropped| dropped.reason.kind())
            .collect();
        kinds.sort_unstable();
        kinds.dedup();
        for kind in kinds {
            let of_kind = |dropped: &&DroppedFrame| dropped.reason.kind() == kind;
            let all: Vec<&DroppedFrame> = dropped.iter().filter(of_kind).collect();
            let (first, reason) = (all[0].stamp, &all[0].reason);
            tell(&format!(
                "left out  {} {kind}; the first: {first}: {reason}",
                all.len()
            ));
        }
        if json {
            let value = json!({
                "recording": self.path.display().to_string(), "images": found.len() + dropped.len(), "with_points": found.len(),
                "left_out": dropped.len(), "camera": self.frames.seen_by(), "remarks": self.frames.remarks,
            });
            ui::print(&value.to_string());
            for DroppedFrame { stamp, reason } in dropped {
                let value = json!({
                    "image": stamp.to_string(), "status": "left out", "reason": reason.to_string(),
                });
                ui::print(&value.to_string());
            }
        }
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// In the order of the recording.
    pub(super) fn frames(&self) -> &[SyncedFrame] {
        &self.frames.found
    }

    /// Name of a frame in the results.
    pub(super) fn name(frame: &SyncedFrame) -> PathBuf {
        frame.stamp.to_string().into()
    }

    fn read(&self, frame: &SyncedFrame) -> Result<FrameMessages> {
        let mut recording = self
            .recording
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        self.frames.read(&mut recording, frame)
    }

    /// A frame, and when and where its image was taken.
    pub(super) fn load(&self, frame: &SyncedFrame) -> Result<(Header, Loaded)> {
        let started = Instant::now();
        let found = self.read(frame)?.decode(&self.frames)?;
        let loaded = Loaded {
            rgb: found.image,
            points: found.points,
            unplaced: found.unplaced,
            skewed: found.skewed,
            camera: found.camera,
            guide: None,
            noise: None,
            views: None,
            reading: started.elapsed(),
        };
        Ok((found.header, loaded))
    }

    /// The points of a frame and its camera, without its image.
    pub(super) fn points(&self, frame: &SyncedFrame) -> Result<DecodedPoints> {
        self.read(frame)?.decode_points(&self.frames)
    }

    /// Whether the camera of the images is known.
    pub(super) fn has_camera(&self) -> bool {
        self.frames.seen_by().is_some()
    }

    /// From the frame that motion is measured in to the cameras.
    pub(super) fn camera_route(&self) -> Result<Route> {
        self.frames.camera_route()
    }

    /// Pose of the camera when it took the image.
    pub(super) fn camera_pose(
        &self,
        route: &Route,
        frame: &SyncedFrame,
    ) -> std::result::Result<Rigid, TransformGap> {
        self.frames.camera_pose(route, frame)
    }

    /// The points of a frame as its camera would see them after this number of nanoseconds, if transforms are known.
    pub(super) fn seen_after(
        &self,
        frame: &SyncedFrame,
        seen: (&Observations, &Camera),
        nanoseconds: i64,
    ) -> Option<Observations> {
        self.frames.seen_after(frame, seen, nanoseconds)
    }

    /// Hash of the contents of a frame.
    pub(super) fn content(&self, frame: &SyncedFrame) -> Result<String> {
        let stored = self.read(frame)?;
        let projection = stored.projection(&self.frames);
        Ok(provenance::bytes_hash(&[
            &stored.image,
            &stored.points,
            projection.as_bytes(),
        ]))
    }
}

/// Checks that a recording is meant where no image is given, and that its options are given for one alone.
pub(super) fn check(args: &Complete) -> Result<()> {
    let given = args.recorded.given();
    if !args.rgb.is_empty() {
        return match given.first() {
            Some(option) => Err(Error::config(format!("`{option}` is for a recording"))
                .hint("give the recording alone: lsdc complete drive.mcap --image TOPIC --points TOPIC -o DIR")),
            None => Ok(()),
        };
    }
    let path = &args.sparse;
    if Recording::is_at(path) {
        return if path.exists() {
            Ok(())
        } else {
            Err(Error::read(path, std::io::ErrorKind::NotFound.into()))
        };
    }
    check_foreign(path)?;
    Err(Error::config(format!(
        "one input alone, `{}`, is no recording",
        path.display()
    ))
    .hint(
        "give an image and its points, or a recording of ROS 2: mcap, db3, or the folder of a bag",
    ))
}
