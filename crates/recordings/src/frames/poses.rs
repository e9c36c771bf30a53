//! Poses of the cameras in the frame in which motion is measured.

use super::rig::Rig;
use super::{Frames, SyncedFrame};
use crate::message::Timestamp;
use crate::rigid::Rigid;
use crate::transforms::{Route, TransformGap};
use lsdc_files::error::{Error, Result};

/// Number of images before an image, and after it in a recording, among which its neighbours with points of their own are
/// found.
pub const NEIGHBOUR_WINDOW: usize = 20;

/// Pose of a camera when it took an image.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraPose {
    /// Frame in which motion is measured.
    pub fixed: String,
    /// Transform from that frame to the camera's frame or, for a given camera, to the frame of the points, which it is
    /// given in.
    pub rigid: Rigid,
}

impl Frames {
    /// Returns the route from the frame in which motion is measured to that of the cameras, for [`Self::camera_pose`]. A
    /// given camera is in the frame of the points.
    ///
    /// # Errors
    /// No transforms lead there, or none of them moves, so that the pose of the camera is unknown.
    pub fn camera_route(&self) -> Result<Route> {
        self.rig.camera_route()
    }

    /// Returns the transform from the frame in which motion is measured to that of the camera, at the time of the image.
    ///
    /// # Errors
    /// The transforms do not cover that time.
    pub fn camera_pose(
        &self,
        route: &Route,
        frame: &SyncedFrame,
    ) -> std::result::Result<Rigid, TransformGap> {
        self.rig.transforms.between(route, [frame.stamp; 2])
    }
}

impl Rig {
    /// Returns [`Frames::camera_route`].
    pub(super) fn camera_route(&self) -> Result<Route> {
        let frames = self.frames.clone().unwrap_or_default();
        let [image, points] = &frames;
        let own = if self.given_camera.is_some() {
            points
        } else {
            image
        };
        let fixed = if let Some(route) = &self.route {
            route.fixed().to_owned()
        } else {
            let route = self.transforms.route(own, own, self.fixed.as_deref())?;
            route.fixed().to_owned()
        };
        let route = self.transforms.route(&fixed, own, Some(&fixed))?;
        if self.transforms.is_dynamic(&route) {
            return Ok(route);
        }
        let what = format!("no transforms that move lead from `{fixed}` to `{own}`");
        Err(Error::config(what).hint(
            "record /tf with the odometry, name its frame by --fixed-frame, or give a trajectory",
        ))
    }

    /// Returns the pose of the camera at a time, if the transforms cover it.
    pub(super) fn camera_pose(&self, route: &Route, stamp: Timestamp) -> Option<CameraPose> {
        let rigid = self.transforms.along(route).between(route, [stamp; 2]);
        Some(CameraPose {
            fixed: route.fixed().to_owned(),
            rigid: rigid.ok()?,
        })
    }
}
