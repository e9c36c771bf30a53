//! Where the cameras of a recording are in the frame that motion is measured in.

use super::{Frames, SyncedFrame};
use crate::rigid::Rigid;
use crate::transforms::{Route, TransformGap};
use lsdc_files::error::{Error, Result};

impl Frames {
    /// The route from the frame that motion is measured in to that of the cameras, for [`Self::camera_pose`]. A given camera is in the
    /// frame of the points.
    ///
    /// # Errors
    /// Transforms that lead from no such frame, or that do not move: then it is not known where the camera was.
    pub fn camera_route(&self) -> Result<Route> {
        let rig = &self.rig;
        let frames = rig.frames.clone().unwrap_or_default();
        let [image, points] = &frames;
        let own = if rig.given_camera.is_some() {
            points
        } else {
            image
        };
        let fixed = if let Some(route) = &rig.route {
            route.fixed().to_owned()
        } else {
            let route = rig.transforms.route(own, own, rig.fixed.as_deref())?;
            route.fixed().to_owned()
        };
        let route = rig.transforms.route(&fixed, own, Some(&fixed))?;
        if rig.transforms.is_dynamic(&route) {
            return Ok(route);
        }
        let what = format!("no transforms that move lead from `{fixed}` to `{own}`");
        Err(Error::config(what).hint(
            "record /tf with the odometry, name its frame by --fixed-frame, or give a trajectory",
        ))
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
