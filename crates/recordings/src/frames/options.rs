//! Options of the frames of a recording.

use lsdc_files::{Camera, Unit};
use std::time::Duration;

/// Which topics the frames of a recording are read from, and how points are matched to images.
#[derive(Clone, Debug)]
pub struct FrameOptions {
    /// The topic of images; not needed where there is one.
    pub image: Option<String>,
    /// The topic of points, clouds or images of depths; not needed where there is one of clouds.
    pub points: Option<String>,
    /// The topic of the camera; else `camera_info` beside the images.
    pub camera_info: Option<String>,
    /// Topics of transforms; else all. Those of a name that ends with `static` are valid at all times.
    pub tf: Vec<String>,
    /// The frame that motion is measured in; else as [`Transforms::route`](crate::transforms::Transforms::route) chooses it.
    pub fixed: Option<String>,
    /// The largest time between an image and its points.
    pub tolerance: Duration,
    /// The camera, at its place in the frame of the points, instead of what the recording says of both.
    pub camera: Option<Camera>,
    /// What depths and coordinates of clouds are stored in; else millimetres for whole numbers and metres for others.
    pub unit: Option<Unit>,
    /// Whether motion within a cloud is compensated, by the times of its points; else all points have the stamp of their
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
            // Half the time between two turns of most scanners.
            tolerance: Duration::from_millis(50),
            camera: None,
            unit: None,
            deskew: true,
        }
    }
}
