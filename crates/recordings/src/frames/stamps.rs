//! The points of a frame as its camera would see them at another stamp, to detect clock offsets.

use super::{Frames, SyncedFrame};
use lsdc_core::{Observation, Observations};
use lsdc_files::Camera;

impl Frames {
    /// Returns the points of a frame, in order, as its camera would see them `nanoseconds` after the stamp of the image.
    /// Points behind the camera have no depth (NaN). `None` if nothing moves, or if the transforms do not cover that time.
    ///
    /// `points` and `camera` are those of the [decoded](super::DecodedFrame) frame.
    pub fn seen_after(
        &self,
        frame: &SyncedFrame,
        (points, camera): (&Observations, &Camera),
        nanoseconds: i64,
    ) -> Option<Observations> {
        let route = self.rig.route.as_ref()?;
        if !self.rig.transforms.is_dynamic(route) {
            return None;
        }
        let at = |stamp| {
            let moved = self
                .rig
                .transforms
                .between(route, [frame.points_stamp, stamp]);
            moved.ok()
        };
        let later = frame.stamp.checked_add(nanoseconds)?;
        let motion = at(later)?.after(at(frame.stamp)?.inverse());
        let see = |point: &Observation| {
            let position = camera.unproject([point.u, point.v], f64::from(point.depth))?;
            let ([u, v], depth) = camera.project(motion.apply(position))?;
            let depth = depth as f32;
            Some(Observation {
                u,
                v,
                depth,
                ..*point
            })
        };
        let hidden = |point: &Observation| Observation {
            depth: f32::NAN,
            ..*point
        };
        let seen = points
            .iter()
            .map(|point| see(point).unwrap_or(hidden(point)));
        Some(seen.collect())
    }
}
