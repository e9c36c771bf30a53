//! A depth map in space.

use crate::{Camera, Colored, DepthMap};
use image::RgbImage;

/// The pixels of a depth map in space, with the colours of the image.
#[derive(Clone, Debug, PartialEq)]
pub struct Cloud {
    /// One for each pixel with a depth that is not left out, row by row.
    pub points: Vec<Colored>,
    /// Pixels that are left out, as their standard deviation is too large.
    pub uncertain: usize,
    /// Pixels that are left out, as the lens does not look there.
    pub unseen: usize,
}

impl Cloud {
    /// Of a depth map of any size, seen by the camera of the upright image `rgb`. `deviations` are the standard
    /// deviations of the depths in metres, in a map of the same size, and `max_sigma` the largest that is kept.
    pub fn new(
        depth: &DepthMap,
        deviations: Option<&DepthMap>,
        rgb: &RgbImage,
        camera: &Camera,
        max_sigma: Option<f32>,
    ) -> Self {
        let (width, height) = (depth.width(), depth.height());
        let camera = camera.stretched((width, height));
        let shown = (rgb.width() as usize, rgb.height() as usize);
        let mut cloud = Self {
            points: Vec::new(),
            uncertain: 0,
            unseen: 0,
        };
        for point in depth.points() {
            let sigma = deviations.and_then(|map| map.get(point.x, point.y));
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
            let color = rgb.get_pixel(
                (point.x * shown.0 / width) as u32,
                (point.y * shown.1 / height) as u32,
            );
            cloud.points.push(Colored {
                place,
                color: color.0,
                sigma,
            });
        }
        cloud
    }
}
