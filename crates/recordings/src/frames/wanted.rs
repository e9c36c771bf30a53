//! Which frames are wanted of a recording, and how they are made.

use lsdc_files::{Camera, Unit};
use std::time::Duration;

/// Which frames are wanted of a recording.
#[derive(Clone, Debug)]
pub struct Wanted {
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
    /// How far points may be from an image in time.
    pub tolerance: Duration,
    /// The camera, at its place in the frame of the points, instead of what the recording says of both.
    pub camera: Option<Camera>,
    /// What depths and coordinates of clouds are stored in; else millimetres for whole numbers and metres for others.
    pub unit: Option<Unit>,
    /// Whether points that have times of their own are seen from where the scanner was at these; else all count at the stamp of
    /// their cloud.
    pub deskew: bool,
}

impl Default for Wanted {
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
