//! The readers of the program, for Python.

use crate::arrays;
use crate::error::Kind;
use lsdc_core::Observation;
use lsdc_files::error::{Cause, Error};
use lsdc_files::{Camera, Contents, Orientation, Sparse, View};
use numpy::PyArray2;
use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// What was said about reading: the unit, whether it was a guess, and what should be checked.
type Said = (String, bool, Vec<String>);

/// Rows x, y, depth[, sigma]; points that were ignored, outside and hidden; what was said.
type Points<'py> = (Bound<'py, PyArray2<f64>>, [usize; 3], Said);

/// A map in metres, its standard deviations if the file has them, and what was said.
type Map<'py> = (
    Bound<'py, PyArray2<f32>>,
    Option<Bound<'py, PyArray2<f32>>>,
    Said,
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
    let found = py.detach(|| read(&path)).map_err(|e| raised(py, &e))?;
    let said = (found.unit.to_string(), found.guessed, found.remarks);
    let sigma = found
        .sigma
        .map(|sigma| arrays::map(py, sigma))
        .transpose()?;
    Ok((arrays::map(py, found.depth)?, sigma, said))
}

#[pyfunction]
pub(crate) fn read_points<'py>(
    py: Python<'py>,
    path: PathBuf,
    size: (usize, usize),
    camera: Option<PathBuf>,
    unit: Option<&str>,
) -> PyResult<Points<'py>> {
    let read = || {
        let camera = camera.map(|path| Camera::read(&path)).transpose()?;
        let mut found = Sparse::read(
            &path,
            unit.map(str::parse).transpose()?,
            camera.as_ref(),
            size,
        )?;
        found.remarks.extend(camera.iter().flat_map(Camera::doubts));
        Ok(found)
    };
    let found = py.detach(read).map_err(|e| raised(py, &e))?;
    points(py, found)
}

/// A model of COLMAP.
#[pyclass(frozen, module = "lsdc._native")]
pub(crate) struct Colmap(lsdc_files::Colmap);

#[pymethods]
impl Colmap {
    /// In a folder, or the contents of its files by name.
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
        found.map(Self).map_err(|e| raised(py, &e))
    }

    /// The names of its images, and their widths and heights.
    fn images(&self) -> Vec<(String, (usize, usize))> {
        let views = self.0.views.iter();
        views.map(|view| (view.name.clone(), view.size)).collect()
    }

    /// What an image sees that is stored with this size and orientation by EXIF.
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
            return Err(Kind::Input.raise(py, &what, Some("`Colmap.images` names them")));
        };
        let image = Orientation::new(size.unwrap_or(view.size), exif);
        let found = py.detach(|| Sparse::of_view(view, image, None));
        let found = found.map_err(|e| raised(py, &e))?;
        points(py, found)
    }
}

fn points(py: Python<'_>, mut found: Sparse) -> PyResult<Points<'_>> {
    let known = found.points.iter().filter(|point| point.sigma.is_some());
    let known = known.count();
    let certain = known == found.points.len();
    if known > 0 && !certain {
        let all = found.points.len();
        let what = "standard deviations are left out, because only";
        found
            .remarks
            .push(format!("{what} {known} of {all} points have one"));
    }
    let row = |point: &Observation| {
        let known = [point.u, point.v, f64::from(point.depth)];
        let sigma = point.sigma.filter(|_| certain).map(f64::from);
        known.into_iter().chain(sigma)
    };
    let columns = if certain && !found.points.is_empty() {
        4
    } else {
        3
    };
    let values = found.points.iter().flat_map(row).collect();
    let counts = [found.ignored, found.outside, found.hidden];
    let said = (found.unit.to_string(), found.guessed, found.remarks);
    Ok((arrays::table(py, values, columns)?, counts, said))
}

/// The exception that stands for an error of a file.
fn raised(py: Python<'_>, error: &Error) -> PyErr {
    let kind = match error.cause() {
        Cause::Read | Cause::Format => Kind::Read,
        Cause::Shape => Kind::Input,
        Cause::Config => Kind::Settings,
        _ => Kind::Base,
    };
    kind.raise(py, &error.with_causes(), error.advice())
}
