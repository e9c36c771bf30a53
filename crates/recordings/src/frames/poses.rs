//! Where the cameras are in the frame that motion is measured in.

use super::rig::Rig;
use super::{Frames, SyncedFrame};
use crate::message::Timestamp;
use crate::rigid::Rigid;
use crate::transforms::{Route, TransformGap};
use lsdc_files::error::{Error, Result};

/// Neighbours of an image are among so many images before it, and after it in a recording, that have points of their own.
pub const NEIGHBOUR_WINDOW: usize = 20;

/// Where a camera was when it took an image.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraPose {
    /// The frame that motion is measured in.
    pub fixed: String,
    /// From that frame to the one of the camera; of a given camera, to the one of the points, which it is in.
    pub rigid: Rigid,
}

impl Frames {
    /// The route from the frame that motion is measured in to that of the cameras, for [`Self::camera_pose`]. A given camera is in the
    /// frame of the points.
    ///
    /// # Errors
    /// Transforms that lead from no such frame, or that do not move: then it is not known where the camera was.
    pub fn camera_route(&self) -> Result<Route> {
        self.rig.camera_route()
    }

    /// The motion from the frame that motion is measured in to that of the camera, when it took the image.
    ///
    /// # Errors
    /// Transforms do not reach that time.
    pub fn camera_pose(
        &self,
        route: &Route,
        frame: &SyncedFrame,
    ) -> std::result::Result<Rigid, TransformGap> {
        self.rig.transforms.between(route, [frame.stamp; 2])
    }
}

impl Rig {
    /// As of [`Frames`].
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

    /// Where the camera was at a time, if transforms reach it.
    pub(super) fn camera_pose(&self, route: &Route, stamp: Timestamp) -> Option<CameraPose> {
        let rigid = self.transforms.along(route).between(route, [stamp; 2]);
        Some(CameraPose {
            fixed: route.fixed().to_owned(),
            rigid: rigid.ok()?,
        })
    }
}
