//! The readers of the program, for Python.

use crate::arrays;
use crate::camera::Camera;
use crate::checks::texts;
use crate::error::{ExceptionKind, raised_by_file};
use lsdc_core::Observation;
use lsdc_files::error::Error;
use lsdc_files::{Contents, DepthReadOptions, Orientation, Sparse, UprightImage, View};
use numpy::{PyArray1, PyArray2, PyArray3, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Notes of a reader: the unit, whether it was guessed, and remarks to be checked.
type ReadingNotes = (String, bool, Vec<String>);

/// Rows x, y, depth[, sigma]; numbers of ignored, outside and hidden points; the notes of the reader.
type Points<'py> = (Bound<'py, PyArray2<f64>>, [usize; 3], ReadingNotes);

/// A map in metres, its standard deviations if the file has them, and the notes of the reader.
type Map<'py> = (
    Bound<'py, PyArray2<f32>>,
    Option<Bound<'py, PyArray2<f32>>>,
    ReadingNotes,
);

#[pyfunction]
pub(crate) fn read_depth<'py>(
    py: Python<'py>,
    path: PathBuf,
    unit: Option<&str>,
) -> PyResult<Map<'py>> {
    let read = |path: &Path| match Contents::read(path, unit.map(str::parse).transpose()?)? {
        Contents::Map(map) => Ok(*map),
        _ => Err(Error::format(path, "holds no map of depths")
            .hint("points are read by `read_points`, models of COLMAP by `Colmap`")),
    };
    let found = py
        .detach(|| read(&path))
        .map_err(|e| raised_by_file(py, &e))?;
    let notes = (found.unit.to_string(), found.guessed, found.remarks);
    let sigma = found
        .sigma
        .map(|sigma| arrays::map(py, sigma))
        .transpose()?;
    Ok((arrays::map(py, found.depth)?, sigma, notes))
}

/// Returns the colours `(H, W, 3)` of an image file, upright, and remarks to be checked.
#[pyfunction]
pub(crate) fn read_image(
    py: Python<'_>,
    path: PathBuf,
) -> PyResult<(Bound<'_, PyArray3<u8>>, Vec<String>)> {
    let found = py.detach(|| lsdc_files::read_upright(&path));
    let UprightImage { rgb, warnings, .. } = found.map_err(|e| raised_by_file(py, &e))?;
    let shape = [rgb.height() as usize, rgb.width() as usize, 3];
    let colours = PyArray1::from_vec(py, rgb.into_raw()).reshape(shape)?;
    Ok((colours, texts(&warnings)))
}

#[pyfunction]
pub(crate) fn read_points<'py>(
    py: Python<'py>,
    path: PathBuf,
    size: (usize, usize),
    camera: Option<&Camera>,
    unit: Option<&str>,
    kind: Option<&str>,
) -> PyResult<Points<'py>> {
    let read = || {
        let how = DepthReadOptions {
            unit: unit.map(str::parse).transpose()?,
            kind: kind.map(str::parse).transpose()?,
        };
        let mut found = Sparse::read_as(&path, how, camera.map(|camera| &camera.0), size)?;
        let warnings = camera.iter().flat_map(|camera| camera.0.warnings());
        found.remarks.extend(warnings);
        Ok(found)
    };
    let found = py.detach(read).map_err(|e| raised_by_file(py, &e))?;
    let certain = found.points.iter().any(|point| point.sigma.is_some());
    points(py, found, certain)
}

/// A COLMAP model.
#[pyclass(frozen, module = "lsdc._native")]
pub(crate) struct Colmap(lsdc_files::Colmap);

#[pymethods]
impl Colmap {
    /// Reads a model from a folder, or from the contents of its files by name.
    #[new]
    fn new(
        py: Python<'_>,
        folder: PathBuf,
        files: Option<HashMap<String, PyBackedBytes>>,
    ) -> PyResult<Self> {
        let found = py.detach(|| match files {
            None => lsdc_files::Colmap::read(&folder),
            Some(files) => lsdc_files::Colmap::of_files(&folder, |name| Ok(files.get(name))),
        });
        found.map(Self).map_err(|e| raised_by_file(py, &e))
    }

    /// Returns the names of its images, and their widths and heights.
    fn images(&self) -> Vec<(String, (usize, usize))> {
        let views = self.0.views.iter();
        views.map(|view| (view.name.clone(), view.size)).collect()
    }

    /// Returns the points seen by an image that is stored with this size and EXIF orientation.
    fn points<'py>(
        &self,
        py: Python<'py>,
        name: &str,
        size: Option<(usize, usize)>,
        exif: u8,
    ) -> PyResult<Points<'py>> {
        let found: Option<&View> = self.0.views.iter().find(|view| view.name == name);
        let Some(view) = found else {
            let what = format!("the model has no image `{name}`");
            return Err(ExceptionKind::Input.raise(py, &what, Some("`Colmap.images` names them")));
        };
        let image = Orientation::new(size.unwrap_or(view.size), exif);
        let found = py.detach(|| Sparse::of_view(view, image, None));
        let found = found.map_err(|e| raised_by_file(py, &e))?;
        points(py, found, true)
    }
}

/// Converts points to rows, with standard deviations if `certain`. Missing ones are NaN.
fn points(py: Python<'_>, found: Sparse, certain: bool) -> PyResult<Points<'_>> {
    let row = |point: &Observation| {
        let known = [point.u, point.v, f64::from(point.depth)];
        let sigma = point.sigma.map_or(f64::NAN, f64::from);
        known.into_iter().chain(certain.then_some(sigma))
    };
    let values = found.points.iter().flat_map(row).collect();
    let counts = [found.ignored, found.outside, found.hidden];
    let notes = (found.unit.to_string(), found.guessed, found.remarks);
    Ok((
        arrays::table(py, values, if certain { 4 } else { 3 })?,
        counts,
        notes,
    ))
}
