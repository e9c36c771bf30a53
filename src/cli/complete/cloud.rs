//! A result in space.

use super::frame::Completed;
use super::inputs::Loaded;
use crate::data::Colored;
use crate::error::{Error, Result};

/// The pixels in space, with the colours of the image.
pub(super) struct Cloud {
    pub(super) points: Vec<Colored>,
    /// Pixels that are left out, as their standard deviation is too large.
    pub(super) uncertain: usize,
    /// Pixels that are left out, as the lens does not look there.
    pub(super) unseen: usize,
}

impl Cloud {
    /// Of a frame; `max_sigma` is the largest standard deviation.
    pub(super) fn of(frame: &Loaded, found: &Completed, max_sigma: Option<f32>) -> Result<Self> {
        let depth = &found.depth;
        let (width, height) = (depth.width(), depth.height());
        let camera = frame.camera.as_ref().ok_or_else(no_camera)?;
        let camera = camera.stretched((width, height));
        let shown = (frame.rgb.width() as usize, frame.rgb.height() as usize);
        let diagnostics = found.diagnostics.as_ref();
        let deviations = diagnostics.and_then(|found| found.deviations.as_ref());
        let mut cloud = Self {
            points: Vec::new(),
            uncertain: 0,
            unseen: 0,
        };
        for point in depth.points() {
            let sigma = deviations.map(|map| map.at(point.x, point.y));
            let known = sigma.zip(max_sigma);
            if known.is_some_and(|(sigma, most)| sigma > most) {
                cloud.uncertain += 1;
                continue;
            }
            let pixel = [point.x as f64, point.y as f64];
            let Some(place) = camera.unproject(pixel, f64::from(point.depth)) else {
                cloud.unseen += 1;
                continue;
            };
            let color = frame.rgb.get_pixel(
                (point.x * shown.0 / width) as u32,
                (point.y * shown.1 / height) as u32,
            );
            cloud.points.push(Colored {
                place,
                color: color.0,
                sigma,
            });
        }
        Ok(cloud)
    }
}

fn no_camera() -> Error {
    Error::config("a cloud needs a camera")
        .hint("give --camera FILE, --camera FX,FY,CX,CY, or points of a model of COLMAP")
}
