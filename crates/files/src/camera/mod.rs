//! Cameras: projection of points to the image, and back-projection of pixels.

mod file;
mod ros;
mod stored;

pub use ros::CameraInfo;

use super::Orientation;
use super::grid::{pixel, same_shape};
use crate::error::{Error, Result};
use crate::pose::Pose;
use lsdc_core::{DepthMap, Lens, Projection, SettingsError};
use std::fmt::{Display, Formatter};

/// The camera of an upright image, whose file may store it in another orientation.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Width and height of the upright image, if known.
    size: Option<(usize, usize)>,
    /// Camera of the pixels as stored.
    optics: lsdc_core::Camera,
    /// Orientation of the stored image, if known.
    turned: Option<Orientation>,
    /// Assumptions about values that its file lacks, a sentence each.
    assumed: Vec<String>,
}

impl Camera {
    /// Creates a camera without distortion at the origin.
    pub fn pinhole(focal: [f64; 2], center: [f64; 2]) -> Self {
        Self::new(lsdc_core::Camera::pinhole(focal, center), None)
    }

    /// Creates the camera of an image that is stored upright, with its width and height, if known.
    pub fn new(optics: lsdc_core::Camera, size: Option<(usize, usize)>) -> Self {
        Self {
            size,
            optics,
            turned: None,
            assumed: Vec::new(),
        }
    }

    /// Returns the camera of the pixels as stored.
    pub fn optics(&self) -> &lsdc_core::Camera {
        &self.optics
    }

    pub(super) fn with_lens(self, lens: Lens) -> Self {
        Self {
            optics: self.optics.with_lens(lens),
            ..self
        }
    }

    pub(super) fn with_size(self, size: (usize, usize)) -> Self {
        Self {
            size: Some(size),
            ..self
        }
    }

    /// Returns the camera at another pose: a point of the world is first rotated (the matrix is given row by row), then
    /// translated.
    #[must_use]
    pub fn with_pose(self, rotation: [[f64; 3]; 3], translation: [f64; 3]) -> Self {
        Self {
            optics: self.optics.with_pose(rotation, translation),
            ..self
        }
    }

    /// Returns the camera for another world: its points are transformed into this world by a rotation (row by row) and a
    /// translation.
    #[must_use]
    pub fn moved(self, rotation: [[f64; 3]; 3], translation: [f64; 3]) -> Self {
        let first = Pose {
            rotation,
            translation,
        };
        let own = self.pose();
        let pose = if own == Pose::IDENTITY {
            first
        } else {
            own.after(first)
        };
        self.with_pose(pose.rotation, pose.translation)
    }

    fn pose(&self) -> Pose {
        let (rotation, translation) = self.optics.pose();
        Pose {
            rotation,
            translation,
        }
    }

    /// Returns the camera in a world with another unit: coordinates are multiplied by `factor`.
    pub(super) fn in_unit(self, factor: f64) -> Self {
        let (rotation, translation) = self.optics.pose();
        self.with_pose(rotation, translation.map(|v| v * factor))
    }

    /// Returns the camera of the same image at another size. This adds one of the [`Self::warnings`], because a crop of the
    /// same shape would have another camera.
    ///
    /// # Errors
    /// The size has another shape: it is that of a crop, or of another image.
    pub fn resized(&self, size: (usize, usize)) -> Result<Self> {
        match self.size {
            Some(own) if !same_shape(own, size) => Err(other_shape(own, size)),
            Some(own) if own != size => {
                let mut camera = self.stretched(size);
                camera.assumed.push(format!(
                    "the camera of images of {}x{} is scaled to {}x{}: the image is taken for all of such an image at another size",
                    own.0, own.1, size.0, size.1
                ));
                Ok(camera)
            }
            _ => Ok(self.stretched(size)),
        }
    }

    /// Returns the camera of the same image on a grid of any width and height, whose pixels may then not be square.
    #[must_use]
    pub fn stretched(&self, size: (usize, usize)) -> Self {
        let from = self.size.unwrap_or(size);
        let turned = self.turned.map(|turned| turned.resized(size));
        let stored = |size, turned: Option<Orientation>| turned.map_or(size, |t| t.stored());
        let (from, to) = (stored(from, self.turned), stored(size, turned));
        let factor = |from: usize, to: usize| to as f64 / from.max(1) as f64;
        Self {
            size: Some(size),
            optics: self
                .optics
                .scaled([factor(from.0, to.0), factor(from.1, to.1)]),
            turned,
            assumed: self.assumed.clone(),
        }
    }

    /// Returns the camera of the upright image, with a warning if the file stores the image rotated. If the size is
    /// ambiguous, the camera is taken to be that of the stored pixels, because calibrations do not depend on how a camera
    /// was held. Without a size, the principal point decides.
    ///
    /// # Errors
    /// The camera was calibrated for an image of another shape.
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
            ..self.resized(stored)?
        };
        let what = format!(
            "the camera is taken for that of the pixels as stored, {}x{}, and turned upright with the \
             image (EXIF orientation {exif})",
            stored.0, stored.1
        );
        Ok((camera, Some(what)))
    }

    /// Rotates a map of the upright image to the stored orientation; `None` if the image is stored upright.
    ///
    /// # Errors
    /// None for maps of a plausible size.
    pub fn as_stored(&self, map: &DepthMap) -> Result<Option<DepthMap>> {
        let Some(turned) = self.turned.filter(|turned| !turned.is_upright()) else {
            return Ok(None);
        };
        let turned = turned.resized((map.width(), map.height()));
        let (width, height) = turned.stored();
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| [x, y]));
        let values = pixels.map(|pixel| {
            let [u, v] = turned.turned(pixel.map(|v| v as f64));
            map.at(u as usize, v as usize)
        });
        Ok(Some(DepthMap::new(width, height, values.collect())?))
    }

    /// Returns warnings about the camera of an image, a sentence each: assumptions about values that its file lacks, and
    /// implausible numbers.
    pub fn warnings(&self) -> Vec<String> {
        let outside = self.size.and_then(|size| {
            let (width, height) = self.turned.map_or(size, |turned| turned.stored());
            let [cx, cy] = self.optics.center();
            pixel([cx, cy], (width, height)).is_none().then(|| {
                format!(
                    "the principal point of the camera, {cx}, {cy}, lies outside the image of \
                     {width}x{height}; cx and cy are pixels of this image"
                )
            })
        });
        self.assumed.iter().cloned().chain(outside).collect()
    }

    /// Returns width and height of the upright image, if known.
    pub fn size(&self) -> Option<(usize, usize)> {
        self.size
    }

    /// Returns the distance of the principal point from the centre of an image, in pixels.
    fn off_centre(&self, (width, height): (usize, usize)) -> f64 {
        let middle = [width, height].map(|length| (length as f64 - 1.0) / 2.0);
        let center = self.optics.center();
        (center[0] - middle[0]).hypot(center[1] - middle[1])
    }

    /// Returns focal lengths and the principal point of the upright image in pixels, `[fx, fy, cx, cy]`, without
    /// distortion.
    pub fn intrinsics(&self) -> [f64; 4] {
        let ([fx, fy], [cx, cy]) = (self.optics.focal(), self.optics.center());
        let upright = |position| {
            self.turned
                .map_or(position, |turned| turned.turned(position))
        };
        let center = upright([cx, cy]);
        let (across, down) = (upright([cx + fx, cy]), upright([cx, cy + fy]));
        // One of the two is along each axis of the image.
        let along =
            |axis: usize| (across[axis] - center[axis]).abs() + (down[axis] - center[axis]).abs();
        [along(0), along(1), center[0], center[1]]
    }

    /// Projects a point of the world to a pixel (column, row) and a depth; `None` behind the camera and where the lens has
    /// no image.
    pub fn project(&self, point: [f64; 3]) -> Option<([f64; 2], f64)> {
        let (pixel, depth) = self.optics.project(point)?;
        let pixel = self.turned.map_or(pixel, |turned| turned.turned(pixel));
        Some((pixel, depth))
    }

    /// Back-projects a pixel (column, row) at a depth to a point of the world; `None` if the lens has no ray for the pixel.
    pub fn unproject(&self, pixel: [f64; 2], depth: f64) -> Option<[f64; 3]> {
        let stored = self.turned.map(|turned| turned.turned_back(pixel));
        self.optics.unproject(stored.unwrap_or(pixel), depth)
    }
}

impl Projection for Camera {
    fn project(&self, point: [f64; 3]) -> Option<([f64; 2], f64)> {
        Self::project(self, point)
    }

    fn unproject(&self, pixel: [f64; 2], depth: f64) -> Option<[f64; 3]> {
        Self::unproject(self, pixel, depth)
    }

    fn check(&self) -> std::result::Result<(), SettingsError> {
        self.optics.check()
    }
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
        let ([fx, fy], [cx, cy]) = (self.optics.focal(), self.optics.center());
        write!(
            f,
            "fx {fx}, fy {fy}, cx {cx}, cy {cy}, {}",
            self.optics.lens().name()
        )?;
        if self.pose() == Pose::IDENTITY {
            Ok(())
        } else {
            write!(f, ", at its place in the world")
        }
    }
}

#[cfg(test)]
mod tests;
