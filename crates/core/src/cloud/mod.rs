//! Point clouds as seen by a camera.

mod flying;
mod occlusion;
mod parallax;
mod surface;
mod window;

use crate::camera::Camera;
use crate::error::Result;
use crate::image::check_size;
use crate::observations::{Observation, Observations};
pub use flying::flying_pixels;
use occlusion::remove_hidden;
use parallax::remove_beside_outlines;
pub use surface::{fronts, is_behind};

/// The points of a cloud that a camera sees, and counts of the other points.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Cloud {
    /// The visible points, at their image positions.
    pub observations: Observations,
    /// Number of points whose coordinates are not finite.
    pub invalid: usize,
    /// Number of points behind the camera or outside the image.
    pub outside: usize,
    /// Number of points occluded by nearer surfaces.
    pub hidden: usize,
}

impl Cloud {
    /// Projects the points of a cloud, in the unit of the camera's pose, into an image of `width` x `height` pixels. Points
    /// occluded by nearer surfaces are dropped. If the nearer points are sparse, some occluded points remain.
    ///
    /// # Errors
    /// An implausible size, or a camera with [invalid parameters](Camera::check).
    ///
    /// ```
    /// # fn main() -> lsdc_core::Result<()> {
    /// use lsdc_core::{Camera, Cloud};
    /// let camera = Camera::pinhole([100.0, 100.0], [31.5, 23.5]);
    /// let points = [[0.0, 0.0, 2.0], [0.1, 0.0, 2.0], [0.0, 0.0, 5.0], [0.0, 0.0, -1.0]];
    /// let cloud = Cloud::seen_by(&camera, 64, 48, points)?;
    /// assert_eq!((cloud.observations.len(), cloud.hidden, cloud.outside), (2, 1, 1));
    /// # Ok(())
    /// # }
    /// ```
    pub fn seen_by(
        camera: &Camera,
        width: usize,
        height: usize,
        points: impl IntoIterator<Item = [f64; 3]>,
    ) -> Result<Self> {
        check_size(width, height)?;
        camera.check()?;
        let (mut invalid, mut outside) = (0, 0);
        let mut found = Vec::new();
        for point in points {
            if point.iter().any(|v| !v.is_finite()) {
                invalid += 1;
                continue;
            }
            match camera.project(point) {
                Some(([u, v], depth)) if pixel([u, v], (width, height)).is_some() => {
                    found.push(Observation::new(u, v, depth as f32));
                }
                _ => outside += 1,
            }
        }
        let visible = visible(&found, (width, height), Viewpoint::Cloud);
        let hidden = visible.iter().filter(|visible| !**visible).count();
        let seen = found.into_iter().zip(visible);
        let seen = seen.filter(|(_, visible)| *visible);
        Ok(Self {
            observations: seen.map(|(point, _)| point).collect(),
            invalid,
            outside,
            hidden,
        })
    }
}

/// The index of the pixel that contains a position, if it is inside an image of `size` (width, height).
pub fn pixel([u, v]: [f64; 2], (width, height): (usize, usize)) -> Option<usize> {
    let within = |place: f64, length: usize| {
        let place = (place + 0.5).floor();
        (place >= 0.0 && place < length as f64).then_some(place as usize)
    };
    Some(within(v, height)? * width + within(u, width)?)
}

/// What is known of the viewpoint of points at image positions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Viewpoint {
    /// They were measured in this image, such as keypoints.
    Camera,
    /// Nothing: the points may be a projected scan.
    #[default]
    Unknown,
    /// They are a projected cloud, through which the camera sees between the points.
    Cloud,
}

/// Whether each point is visible: not occluded by nearer surfaces in the same pixel of an image of `size` (width, height) and,
/// depending on the viewpoint, not by the points around it. The result does not depend on the order of the points.
pub fn visible(
    points: &[Observation],
    (width, height): (usize, usize),
    viewpoint: Viewpoint,
) -> Vec<bool> {
    let at = |point: &Observation| pixel([point.u, point.v], (width, height)).unwrap_or(0);
    let fronts = fronts(
        points.iter().map(|point| (at(point), point)),
        width * height,
    );
    let mut open: Vec<f32> = Vec::new();
    if viewpoint != Viewpoint::Camera {
        let nearest = |front: &f32| if front.is_finite() { *front } else { 0.0 };
        open = fronts.iter().map(nearest).collect();
        remove_beside_outlines(width, &mut open);
    }
    if viewpoint == Viewpoint::Cloud {
        remove_hidden(width, &mut open);
    }
    let is_visible = |point: &Observation| {
        let pixel = at(point);
        !is_behind(point, fronts[pixel]) && open.get(pixel).is_none_or(|&depth| depth > 0.0)
    };
    points.iter().map(is_visible).collect()
}
