//! Cameras: where points appear in the image, and where pixels lie in space.

mod file;
mod lens;
mod ros;

use super::Orientation;
use super::grid::{rescaled, same_shape};
use crate::error::{Error, Result};
pub(super) use lens::Lens;
use std::fmt::{Display, Formatter};

/// A calibrated camera at its place in the world. Pixels count from the centre of the first, as in
/// OpenCV; x points to the right, y down, z forwards.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Width and height of the image, upright, if they are known.
    size: Option<(usize, usize)>,
    /// Of the pixels as they are stored, as the principal point.
    focal: [f64; 2],
    center: [f64; 2],
    lens: Lens,
    /// How the stored image is turned upright, if it is.
    turned: Option<Orientation>,
    /// From the world to the camera.
    pose: Pose,
}

/// A rotation, row by row, and a translation.
type Pose = ([[f64; 3]; 3], [f64; 3]);

impl Camera {
    /// A camera without distortion at the origin.
    pub fn pinhole(focal: [f64; 2], center: [f64; 2]) -> Self {
        Self {
            size: None,
            focal,
            center,
            lens: Lens::Pinhole,
            turned: None,
            pose: (IDENTITY, [0.0; 3]),
        }
    }

    pub(super) fn with_lens(self, lens: Lens) -> Self {
        Self { lens, ..self }
    }

    pub(super) fn with_size(self, size: (usize, usize)) -> Self {
        Self {
            size: Some(size),
            ..self
        }
    }

    pub(super) fn with_pose(self, rotation: [[f64; 3]; 3], translation: [f64; 3]) -> Self {
        Self {
            pose: (rotation, translation),
            ..self
        }
    }

    /// Pixels from edge to edge of a radian straight ahead, the mean of both axes.
    pub(super) fn focal(&self) -> f64 {
        f64::midpoint(self.focal[0], self.focal[1])
    }

    /// The same camera where the world is measured in another unit, so many times as long.
    pub(super) fn in_unit(mut self, factor: f64) -> Self {
        self.pose.1 = self.pose.1.map(|v| v * factor);
        self
    }

    /// The camera of the same image at another size.
    ///
    /// # Errors
    /// A size of another shape: a part of the image, or another image.
    pub fn resized(&self, size: (usize, usize)) -> Result<Self> {
        match self.size {
            Some(own) if !same_shape(own, size) => Err(other_shape(own, size)),
            _ => Ok(self.stretched(size)),
        }
    }

    /// The camera of the same image on a grid of any width and height, whose pixels may then be no
    /// squares.
    #[must_use]
    pub fn stretched(&self, size: (usize, usize)) -> Self {
        let from = self.size.unwrap_or(size);
        let turned = self.turned.map(|turned| turned.resized(size));
        let stored = |size, turned: Option<Orientation>| turned.map_or(size, |t| t.stored());
        let (from, to) = (stored(from, self.turned), stored(size, turned));
        let mut camera = self.clone().with_size(size);
        camera.turned = turned;
        for (axis, (from, to)) in [(from.0, to.0), (from.1, to.1)].into_iter().enumerate() {
            camera.focal[axis] *= to as f64 / from.max(1) as f64;
            camera.center[axis] = rescaled(camera.center[axis], from, to);
        }
        camera
    }

    /// The camera of an image as it is shown, and what is to be said about it, if the file stores the
    /// image turned. A camera belongs to the stored pixels wherever its size leaves the choice, as it
    /// does not know how it was held; without a size the principal point decides.
    ///
    /// # Errors
    /// A camera that was calibrated for an image of another shape.
    pub fn for_image(&self, image: &Orientation) -> Result<(Self, Option<String>)> {
        let (stored, upright) = (image.stored(), image.upright());
        if image.is_upright() {
            return Ok((self.resized(upright)?, None));
        }
        let as_stored = match self.size {
            Some(own) if same_shape(own, stored) => true,
            Some(own) if same_shape(own, upright) => false,
            Some(own) => return Err(other_shape(own, stored)),
            None => self.off_centre(stored) <= self.off_centre(upright),
        };
        let exif = image.exif();
        if !as_stored {
            let what = format!(
                "the camera is taken for that of the upright image, {}x{} (EXIF orientation {exif})",
                upright.0, upright.1
            );
            return Ok((self.resized(upright)?, Some(what)));
        }
        let camera = Self {
            turned: Some(*image),
            size: Some(upright),
            ..self.stretched(stored)
        };
        let what = format!(
            "the camera is taken for that of the pixels as stored, {}x{}, and turned upright with the \
             image (EXIF orientation {exif})",
            stored.0, stored.1
        );
        Ok((camera, Some(what)))
    }

    /// Pixels between the principal point and the centre of an image.
    fn off_centre(&self, (width, height): (usize, usize)) -> f64 {
        let middle = [width, height].map(|length| (length as f64 - 1.0) / 2.0);
        (self.center[0] - middle[0]).hypot(self.center[1] - middle[1])
    }

    /// Pixel (column, row) and depth of a point of the world; `None` behind the camera and where the
    /// lens does not look.
    pub fn project(&self, point: [f64; 3]) -> Option<([f64; 2], f64)> {
        let (rotation, translation) = &self.pose;
        let mut place = *translation;
        for (coordinate, row) in place.iter_mut().zip(rotation) {
            *coordinate += dot(*row, point);
        }
        let [x, y, z] = place;
        if !(z > 0.0 && z.is_finite()) {
            return None;
        }
        let seen = self.lens.distort([x / z, y / z])?;
        let pixel = [0, 1].map(|axis| self.focal[axis] * seen[axis] + self.center[axis]);
        let pixel = self.turned.map_or(pixel, |turned| turned.turned(pixel));
        pixel.iter().all(|v| v.is_finite()).then_some((pixel, z))
    }

    /// The point of the world at a pixel (column, row) and depth; `None` where the lens does not
    /// look.
    pub fn unproject(&self, pixel: [f64; 2], depth: f64) -> Option<[f64; 3]> {
        let pixel = self
            .turned
            .map_or(pixel, |turned| turned.turned_back(pixel));
        let seen = [0, 1].map(|axis| (pixel[axis] - self.center[axis]) / self.focal[axis]);
        let [x, y] = self.lens.undistort(seen)?;
        let (rotation, translation) = &self.pose;
        let place = [
            x * depth - translation[0],
            y * depth - translation[1],
            depth - translation[2],
        ];
        // The inverse of a rotation is its transpose.
        Some([0, 1, 2].map(|axis| dot([0, 1, 2].map(|row| rotation[row][axis]), place)))
    }
}

const IDENTITY: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn other_shape(own: (usize, usize), image: (usize, usize)) -> Error {
    Error::shape(format!(
        "the camera is of images of {}x{}, which is another shape than {}x{}",
        own.0, own.1, image.0, image.1
    ))
    .hint("give the camera of this very image: a cut image has another width, height, cx and cy")
}

impl Display for Camera {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        if let Some((width, height)) = self.size {
            write!(f, "{width}x{height}, ")?;
        }
        let ([fx, fy], [cx, cy]) = (self.focal, self.center);
        write!(
            f,
            "fx {fx}, fy {fy}, cx {cx}, cy {cy}, {}",
            self.lens.name()
        )?;
        if self.pose == (IDENTITY, [0.0; 3]) {
            Ok(())
        } else {
            write!(f, ", at its place in the world")
        }
    }
}

#[cfg(test)]
mod tests;
