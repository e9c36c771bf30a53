//! Cameras, and the points of clouds that they see.

use crate::arrays;
use crate::error::{ExceptionKind, raised, raised_by_file};
use lsdc_core::{Cloud, Lens, SettingsError};
use numpy::{PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use std::path::PathBuf;

/// A calibrated camera with its pose in the world.
#[pyclass(frozen, module = "lsdc._native")]
pub(crate) struct Camera(pub(crate) lsdc_files::Camera);

/// A rotation, row by row, and a translation.
type Pose = ([[f64; 3]; 3], [f64; 3]);

/// Focal lengths, principal point, lens and its coefficients, rotation and translation, width and height of the image.
type CameraParameters = (
    [f64; 2],
    [f64; 2],
    &'static str,
    Vec<f64>,
    Pose,
    Option<(usize, usize)>,
);

/// Rows u, v, depth of the visible points, and the numbers of invalid, outside and hidden points.
type VisiblePoints<'py> = (Bound<'py, PyArray2<f64>>, usize, usize, usize);

#[pymethods]
impl Camera {
    #[new]
    fn new(
        py: Python<'_>,
        focal: [f64; 2],
        center: [f64; 2],
        lens: &str,
        coefficients: Vec<f64>,
        pose: Pose,
        size: Option<(usize, usize)>,
    ) -> PyResult<Self> {
        let lens = match (lens, coefficients.as_slice()) {
            ("pinhole", []) => Ok(Lens::Pinhole),
            ("radtan", given) => padded(given).map(Lens::radial_tangential),
            ("fisheye", given) => padded(given).map(Lens::fisheye),
            ("pinhole", _) => Err("a pinhole has no coefficients".to_owned()),
            (other, _) => Err(format!("`{other}` is not a lens")),
        };
        let hint =
            "lenses: \"pinhole\", \"radtan\" (k1, k2, p1, p2, k3 to k6), \"fisheye\" (k1 to k4)";
        let lens = lens.map_err(|why| ExceptionKind::Settings.raise(py, &why, Some(hint)))?;
        let camera = lsdc_core::Camera::pinhole(focal, center)
            .with_lens(lens)
            .with_pose(pose.0, pose.1);
        let wrong = |error: SettingsError| raised(py, &error.into());
        camera.check().map_err(wrong)?;
        Ok(Self(lsdc_files::Camera::new(camera, size)))
    }

    /// Reads a camera file.
    #[staticmethod]
    fn read(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let found = py.detach(|| lsdc_files::Camera::read(&path));
        found.map(Self).map_err(|error| {
            let error = match error.advice() {
                Some(_) => error,
                None => error.hint(
                    "a camera is a file (TOML, JSON or the camera_info of ROS), or `lsdc.Camera.from_matrix(K, size)`",
                ),
            };
            raised_by_file(py, &error)
        })
    }

    fn numbers(&self) -> CameraParameters {
        let optics = self.0.optics();
        let (focal, center, lens) = (optics.focal(), optics.center(), optics.lens());
        let coefficients = lens.coefficients().to_vec();
        (
            focal,
            center,
            lens.name(),
            coefficients,
            optics.pose(),
            self.0.size(),
        )
    }

    /// Returns the focal lengths and principal point for the image at another resolution.
    fn scaled(&self, factors: [f64; 2]) -> ([f64; 2], [f64; 2]) {
        let camera = self.0.optics().scaled(factors);
        (camera.focal(), camera.center())
    }

    /// Projects rows x, y, z to rows u, v, depth; NaN if a point is not in view.
    fn project<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let points = arrays::rows::<3>(&points)?;
        let seen = |point: &[f64; 3]| match self.0.project(*point) {
            Some(([u, v], depth)) => [u, v, depth],
            None => [f64::NAN; 3],
        };
        let rows = py.detach(|| points.iter().flat_map(seen).collect());
        arrays::table(py, rows, 3)
    }

    /// Converts rows u, v and depths to rows x, y, z; NaN outside the view of the lens.
    fn unproject<'py>(
        &self,
        py: Python<'py>,
        places: PyReadonlyArray2<'_, f64>,
        depths: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let pairs = arrays::rows::<2>(&places)?.iter().zip(depths.as_slice()?);
        let point = |(place, depth): (&[f64; 2], &f64)| {
            let found = self.0.unproject(*place, *depth).filter(|_| *depth > 0.0);
            found.unwrap_or([f64::NAN; 3])
        };
        let rows = py.detach(|| pairs.flat_map(point).collect());
        arrays::table(py, rows, 3)
    }

    /// Returns the points of a cloud of rows x, y, z that are visible in an image.
    fn see<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<'_, f64>,
        width: usize,
        height: usize,
    ) -> PyResult<VisiblePoints<'py>> {
        let points = arrays::rows::<3>(&points)?;
        let cloud =
            py.detach(|| Cloud::seen_by(self.0.optics(), width, height, points.iter().copied()));
        let cloud = cloud.map_err(|error| raised(py, &error))?;
        let seen = cloud.observations.iter();
        let rows = seen.flat_map(|point| [point.u, point.v, f64::from(point.depth)]);
        let table = arrays::table(py, rows.collect(), 3)?;
        Ok((table, cloud.invalid, cloud.outside, cloud.hidden))
    }
}

/// Pads coefficients with zeros.
fn padded<const N: usize>(given: &[f64]) -> Result<[f64; N], String> {
    let mut all = [0.0; N];
    match all.get_mut(..given.len()) {
        Some(first) => {
            first.copy_from_slice(given);
            Ok(all)
        }
        None => Err(format!("a lens with {} coefficients", given.len())),
    }
}
