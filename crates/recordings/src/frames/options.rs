//! Options of the frames of a recording.

use lsdc_files::{Camera, Unit};
use std::time::Duration;

/// Options for reading the frames of a recording: topics, and how points are matched to images.
#[derive(Clone, Debug)]
pub struct FrameOptions {
    /// Topic of images; not needed if there is only one.
    pub image: Option<String>,
    /// Topic of points, clouds or depth images; not needed if there is only one topic of clouds.
    pub points: Option<String>,
    /// Topic of the camera; by default `camera_info` next to the images.
    pub camera_info: Option<String>,
    /// Topics of transforms; all by default. A topic whose name ends with `static` is valid at all times.
    pub tf: Vec<String>,
    /// Frame in which motion is measured; by default chosen by [`Transforms::route`](crate::transforms::Transforms::route).
    pub fixed: Option<String>,
    /// Largest time between an image and its points.
    pub tolerance: Duration,
    /// Camera, with its pose in the frame of the points, instead of the recorded camera and pose.
    pub camera: Option<Camera>,
    /// Unit of stored depths and cloud coordinates; by default millimetres for integers and metres for other numbers.
    pub unit: Option<Unit>,
    /// Whether to compensate motion within a cloud by the times of its points; otherwise all points have the stamp of their
    /// cloud.
    pub deskew: bool,
}

impl Default for FrameOptions {
    fn default() -> Self {
        Self {
            image: None,
            points: None,
            camera_info: None,
            tf: Vec::new(),
            fixed: None,
            // Half the period of most scanners.
            tolerance: Duration::from_millis(50),
            camera: None,
            unit: None,
            deskew: true,
        }
    }
}
