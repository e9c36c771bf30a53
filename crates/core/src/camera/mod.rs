//! Cameras: projection of points to the image, and back-projection of pixels.

mod lens;

pub use lens::Lens;

use crate::error::SettingsError;

/// A calibrated camera with its pose in the world.
///
/// The centre of the first pixel is (0, 0), as in `OpenCV`; x points to the right, y down, z forwards.
///
/// ```
/// use lsdc_core::{Camera, Lens};
/// let camera = Camera::pinhole([500.0, 500.0], [319.5, 239.5])
///     .with_lens(Lens::radial_tangential([-0.2, 0.05, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]));
/// let (pixel, depth) = camera.project([0.4, -0.1, 2.0]).expect("in front of the camera");
/// assert_eq!(depth, 2.0);
/// let back = camera.unproject(pixel, depth).expect("where the lens looks");
/// assert!((back[0] - 0.4).abs() < 1e-8 && (back[1] + 0.1).abs() < 1e-8);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    focal: [f64; 2],
    center: [f64; 2],
    lens: Lens,
    /// Rotation from the world to the camera.
    rotation: [[f64; 3]; 3],
    translation: [f64; 3],
}

const IDENTITY: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

impl Camera {
    /// A camera without distortion at the origin, with the given focal lengths and principal point in pixels.
    pub fn pinhole(focal: [f64; 2], center: [f64; 2]) -> Self {
        Self {
            focal,
            center,
            lens: Lens::Pinhole,
            rotation: IDENTITY,
            translation: [0.0; 3],
        }
    }

    /// The same camera with a distorting lens.
    #[must_use]
    pub fn with_lens(self, lens: Lens) -> Self {
        Self { lens, ..self }
    }

    /// The same camera at another pose: a point of the world is first rotated (the matrix is given row by
    /// row), then translated.
    #[must_use]
    pub fn with_pose(self, rotation: [[f64; 3]; 3], translation: [f64; 3]) -> Self {
        Self {
            rotation,
            translation,
            ..self
        }
    }

    /// The camera for the same image at another resolution: `factors` scale the numbers of columns and rows.
    #[must_use]
    pub fn scaled(&self, factors: [f64; 2]) -> Self {
        let mut camera = self.clone();
        for (axis, factor) in factors.into_iter().enumerate() {
            camera.focal[axis] *= factor;
            camera.center[axis] = (camera.center[axis] + 0.5) * factor - 0.5;
        }
        camera
    }

    /// Checks every number.
    ///
    /// # Errors
    /// Numbers that are not finite, focal lengths that are not above 0, or a pose matrix that is not a rotation because it
    /// mirrors or scales.
    pub fn check(&self) -> Result<(), SettingsError> {
        /// Rotations are often written with few digits.
        const ROUNDING: f64 = 1e-3;
        let rows = &self.rotation;
        let mut numbers = [self.center, self.focal].concat();
        numbers.extend(self.translation.iter().chain(rows.as_flattened()));
        numbers.extend(self.lens.coefficients());
        if !numbers.iter().all(|v| v.is_finite()) {
            return Err(SettingsError::new("a number of the camera is not finite"));
        }
        if !self.focal.iter().all(|length| *length > 0.0) {
            let found = format!(
                "the focal lengths {:?} of the camera are not above 0",
                self.focal
            );
            return Err(SettingsError::new(found));
        }
        let [x, y, z] = *rows;
        let cross = [0, 1, 2].map(|i| {
            let (j, k) = ((i + 1) % 3, (i + 2) % 3);
            x[j] * y[k] - x[k] * y[j]
        });
        let off = |found: f64, expected: f64| (found - expected).abs() > ROUNDING;
        let scales = rows.iter().any(|row| off(dot(*row, *row), 1.0)) || off(dot(x, y), 0.0);
        if scales || (0..3).any(|i| off(cross[i], z[i])) {
            return Err(
                SettingsError::new("the pose of the camera mirrors or scales")
                    .with_hint("give the rows of a rotation"),
            );
        }
        Ok(())
    }

    /// Focal lengths in pixels.
    pub fn focal(&self) -> [f64; 2] {
        self.focal
    }

    /// The principal point in pixels.
    pub fn center(&self) -> [f64; 2] {
        self.center
    }

    /// The lens model.
    pub fn lens(&self) -> &Lens {
        &self.lens
    }

    /// The rotation, row by row, and the translation from the world to the camera.
    pub fn pose(&self) -> ([[f64; 3]; 3], [f64; 3]) {
        (self.rotation, self.translation)
    }

    /// The pixel (column, row) and depth of a point of the world; `None` behind the camera and outside the
    /// valid field of view of the lens.
    pub fn project(&self, point: [f64; 3]) -> Option<([f64; 2], f64)> {
        let mut place = self.translation;
        for (coordinate, row) in place.iter_mut().zip(&self.rotation) {
            *coordinate += dot(*row, point);
        }
        let [x, y, z] = place;
        if !(z > 0.0 && z.is_finite()) {
            return None;
        }
        let distorted = self.lens.distort([x / z, y / z])?;
        let pixel = [0, 1].map(|axis| self.focal[axis] * distorted[axis] + self.center[axis]);
        pixel.iter().all(|v| v.is_finite()).then_some((pixel, z))
    }

    /// The point of the world at a pixel (column, row) and depth; `None` outside the valid field of view of
    /// the lens.
    pub fn unproject(&self, pixel: [f64; 2], depth: f64) -> Option<[f64; 3]> {
        let distorted = [0, 1].map(|axis| (pixel[axis] - self.center[axis]) / self.focal[axis]);
        let [x, y] = self.lens.undistort(distorted)?;
        let place = [
            x * depth - self.translation[0],
            y * depth - self.translation[1],
            depth - self.translation[2],
        ];
        // The inverse of a rotation is its transpose.
        let turned = |axis| dot([0, 1, 2].map(|row: usize| self.rotation[row][axis]), place);
        let point = [0, 1, 2].map(turned);
        point.iter().all(|v| v.is_finite()).then_some(point)
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
