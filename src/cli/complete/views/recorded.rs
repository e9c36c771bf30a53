//! Images of a recording: points are read as they are needed, and kept while they may be those of a neighbour.

use super::{FrameViews, SequenceView};
use crate::cli::args::PoseSource;
use crate::cli::complete::loaded::with_noise;
use crate::cli::complete::recorded::Recorded;
use crate::cli::complete::settings::Settings;
use crate::cli::ui::{self, counted};
use lsdc_core::{DepthNoise, PosedView, ViewSettings, neighbours};
use lsdc_eval::data::Camera;
use lsdc_files::Poses;
use lsdc_files::error::{Error, Result};
use lsdc_recordings::{MessageLocation, NEIGHBOUR_WINDOW, Route, SyncedFrame, Timestamp};
use serde_json::json;
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// The images of a recording whose poses are known.
pub(in crate::cli::complete) struct RecordedViews {
    recorded: Arc<Recorded>,
    poses: CameraPoses,
    settings: ViewSettings,
    noise: Option<DepthNoise>,
    /// In the order of time. Of images with the same points, the one nearest to them in time: points are carried once.
    order: Vec<SyncedFrame>,
    state: Mutex<State>,
}

/// The source of the poses.
enum CameraPoses {
    /// The transforms of the recording.
    Transforms(Route),
    File(PathBuf, Poses),
}

#[derive(Default)]
struct State {
    /// By place in the order; none whose points cannot be read.
    window: BTreeMap<usize, Option<Arc<SequenceView>>>,
    /// The last result, and its image.
    last: Option<(MessageLocation, Option<FrameViews>)>,
}

/// The place of a frame in the order of time.
fn key(frame: &SyncedFrame) -> (Timestamp, MessageLocation) {
    (frame.stamp, frame.location)
}

impl RecordedViews {
    /// Finds the poses of all images, and prints how many have none; nothing without `--views`.
    ///
    /// # Errors
    /// Poses that cannot be read, that no image has, or no camera for them.
    pub(in crate::cli::complete) fn open(
        settings: &Settings,
        recorded: Arc<Recorded>,
    ) -> Result<Option<Self>> {
        let poses = match &settings.views {
            None => return Ok(None),
            Some(PoseSource::Own) => CameraPoses::Transforms(recorded.camera_route()?),
            Some(PoseSource::File(path)) => CameraPoses::File(path.clone(), super::open(path)?),
        };
        if !recorded.has_camera() {
            return Err(super::no_camera());
        }
        let mut found = Self {
            recorded,
            poses,
            settings: settings.neighbours,
            noise: settings.noise,
            order: Vec::new(),
            state: Mutex::default(),
        };
        let mut of_points: BTreeMap<MessageLocation, &SyncedFrame> = BTreeMap::new();
        let distance = |frame: &SyncedFrame| frame.stamp.abs_diff(frame.points_stamp);
        let mut without = Vec::new();
        let recorded = found.recorded.clone();
        for frame in recorded.frames() {
            match found.placed(frame, Camera::pinhole([1.0; 2], [0.0; 2])) {
                Ok(_) => {
                    let other = of_points.entry(frame.points).or_insert(frame);
                    if (distance(frame), key(frame)) < (distance(other), key(other)) {
                        *other = frame;
                    }
                }
                Err(reason) => without.push((frame.stamp, reason)),
            }
        }
        found.order = of_points.into_values().cloned().collect();
        found.order.sort_by_key(key);
        found.tell(settings.json, &without)?;
        Ok(Some(found))
    }

    /// Prints how many images have a pose, and why the first has none that has none.
    fn tell(&self, json: bool, without: &[(Timestamp, String)]) -> Result<()> {
        let all = self.recorded.frames().len();
        let first = without.first();
        let first = first.map(|(stamp, reason)| format!("the first: {stamp}: {reason}"));
        let first = first.unwrap_or_default();
        if self.order.is_empty() {
            let what = format!("none of {all} images has a pose; {first}");
            return Err(Error::format(self.source(), what)
                .hint("poses are found at the stamps of images; --views=FILE names a trajectory"));
        }
        let posed = all - without.len();
        let origin = match &self.poses {
            CameraPoses::Transforms(route) => format!("in `{}`", route.fixed()),
            CameraPoses::File(path, _) => format!("in {}", path.display()),
        };
        let tell = if json { ui::say } else { ui::tell };
        tell(&format!(
            "poses     {} {origin}; neighbours are among {NEIGHBOUR_WINDOW} clouds before{}",
            counted(posed, "image"),
            if self.settings.only_past {
                ""
            } else {
                " and after"
            }
        ));
        if !without.is_empty() {
            ui::warn(&format!(
                "warning: {} without a pose: completed without points of others, {first}",
                counted(without.len(), "image")
            ));
        }
        if json {
            let value =
                json!({"poses": posed, "without_pose": without.len(), "window": NEIGHBOUR_WINDOW});
            ui::print(&value.to_string());
        }
        Ok(())
    }

    /// Path of the poses.
    pub(in crate::cli::complete) fn source(&self) -> &Path {
        match &self.poses {
            CameraPoses::Transforms(_) => self.recorded.path(),
            CameraPoses::File(path, _) => path,
        }
    }

    /// Whether the poses are those of the recording.
    pub(in crate::cli::complete) fn has_own_poses(&self) -> bool {
        matches!(self.poses, CameraPoses::Transforms(_))
    }

    /// The camera of an image at its place in the world, or why that is not known.
    fn placed(&self, frame: &SyncedFrame, camera: Camera) -> std::result::Result<Camera, String> {
        match &self.poses {
            CameraPoses::Transforms(route) => {
                let pose = self.recorded.camera_pose(route, frame);
                let pose = pose.map_err(|gap| gap.to_string())?;
                Ok(camera.moved(pose.matrix(), pose.translation()))
            }
            CameraPoses::File(_, poses) => {
                let pose = poses.of(&frame.stamp.to_string());
                let pose = pose.ok_or("no pose at its stamp")?;
                Ok(camera.with_pose(pose.rotation, pose.translation))
            }
        }
    }

    /// An image and its neighbours; none if its pose is not known, or its points cannot be read.
    ///
    /// The result does not depend on earlier calls.
    pub(in crate::cli::complete) fn find(&self, frame: &SyncedFrame) -> Option<FrameViews> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        match &state.last {
            Some((location, found)) if *location == frame.location => found.clone(),
            _ => {
                let found = self.search(frame, &mut state.window);
                state.last = Some((frame.location, found.clone()));
                found
            }
        }
    }

    fn search(
        &self,
        frame: &SyncedFrame,
        window: &mut BTreeMap<usize, Option<Arc<SequenceView>>>,
    ) -> Option<FrameViews> {
        let place = self.order.partition_point(|other| key(other) < key(frame));
        let around = self.around(place);
        window.retain(|place, _| around.contains(place));
        let own = match self.order.get(place) {
            Some(other) if other.location == frame.location => self.kept(place, window),
            _ => self.read(frame).map(Arc::new),
        }?;
        let before = around.start..place;
        let others = |places: Range<usize>, window: &mut _| -> Vec<Arc<SequenceView>> {
            let places = places.filter(|&place| self.order[place].points != frame.points);
            places
                .filter_map(|place| self.kept(place, window))
                .collect()
        };
        let mut all = others(before, window);
        let index = all.len();
        all.push(own.clone());
        all.extend(others(place..around.end, window));
        let views: Vec<PosedView> = all.iter().map(|one| one.view.clone()).collect();
        let found = neighbours(&views, index, &self.settings).into_iter();
        Some(FrameViews {
            own,
            others: found.map(|other| all[other].clone()).collect(),
            settings: self.settings,
        })
    }

    /// The places of candidates for an image that is at one, and its own.
    fn around(&self, place: usize) -> Range<usize> {
        let after = if self.settings.only_past {
            0
        } else {
            NEIGHBOUR_WINDOW
        };
        let end = (place + after + 1).min(self.order.len());
        place.saturating_sub(NEIGHBOUR_WINDOW)..end
    }

    /// The image at a place, from the window or the recording.
    fn kept(
        &self,
        place: usize,
        window: &mut BTreeMap<usize, Option<Arc<SequenceView>>>,
    ) -> Option<Arc<SequenceView>> {
        let read = || self.read(&self.order[place]).map(Arc::new);
        window.entry(place).or_insert_with(read).clone()
    }

    /// The points of an image with its camera. What is wrong with them is reported where the image is completed.
    fn read(&self, frame: &SyncedFrame) -> Option<SequenceView> {
        let found = self.recorded.points(frame).ok()?;
        let camera = self.placed(frame, found.camera?).ok()?;
        let mut points = found.points;
        with_noise(&mut points, self.noise).ok()?;
        SequenceView::new(Recorded::name(frame), &camera, points).ok()
    }
}
