//! Conversion of arrays to observations.

use crate::arrays;
use crate::error::raised;
use lsdc_core::{DepthMap, DepthNoise, Observation};
use numpy::{PyArray2, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

/// Known depths at some positions of an image.
#[pyclass(frozen, module = "lsdc._native")]
pub(crate) struct Observations {
    pub(crate) all: lsdc_core::Observations,
    /// Number of values of a map that were neither a depth nor 0.
    #[pyo3(get)]
    ignored: usize,
}

#[pymethods]
impl Observations {
    /// Reads the measurements of a map `(height, width)` for an image of this width and height, with standard deviations of the
    /// same shape. A map with fewer or more pixels must show the same view.
    #[staticmethod]
    fn of_map(
        py: Python<'_>,
        map: PyReadonlyArray2<'_, f32>,
        sigma: Option<PyReadonlyArray2<'_, f32>>,
        size: (usize, usize),
    ) -> PyResult<Self> {
        let (height, width) = (map.shape()[0], map.shape()[1]);
        let map = DepthMap::new(width, height, map.as_slice()?.to_vec());
        let map = map.map_err(|error| raised(py, &error))?;
        let mut all = lsdc_core::Observations::from_map(&map);
        if sigma.is_some() || (width, height) != size {
            let sigma = sigma.as_ref().map(|sigma| sigma.as_slice()).transpose()?;
            let observation = |point: &Observation| Observation {
                u: rescaled(point.u, width, size.0),
                v: rescaled(point.v, height, size.1),
                depth: point.depth,
                sigma: sigma.and_then(|sigma| {
                    let pixel = point.v as usize * width + point.u as usize;
                    sigma.get(pixel).copied()
                }),
            };
            all = all.iter().map(observation).collect();
        }
        Ok(Self {
            all,
            ignored: map.ignored(),
        })
    }

    /// Reads one observation for each row u, v, depth, with a standard deviation for each.
    #[staticmethod]
    fn of_table(
        table: PyReadonlyArray2<'_, f64>,
        sigma: Option<PyReadonlyArray1<'_, f32>>,
    ) -> PyResult<Self> {
        let sigma = sigma.as_ref().map(|sigma| sigma.as_slice()).transpose()?;
        let rows = arrays::rows::<3>(&table)?.iter().enumerate();
        let observation = |(i, &[u, v, depth]): (usize, &[f64; 3])| Observation {
            u,
            v,
            depth: depth as f32,
            sigma: sigma.and_then(|sigma| sigma.get(i).copied()),
        };
        Ok(Self {
            all: rows.map(observation).collect(),
            ignored: 0,
        })
    }

    /// Returns the observations, in metres, with the noise of a depth camera (a name, or A,B,C) for those without a standard
    /// deviation.
    fn with_noise(&self, py: Python<'_>, model: &str) -> PyResult<Self> {
        let model = model.parse::<DepthNoise>();
        let model = model.map_err(|error| raised(py, &error.into()))?;
        Ok(Self {
            all: model.applied(&self.all).0,
            ignored: self.ignored,
        })
    }

    /// Returns the observations that nearer ones do not hide in an image of this width and height, and the number of others.
    fn without_hidden(&self, size: (usize, usize)) -> (Self, usize) {
        let mut all = self.all.clone();
        let hidden = all.remove_hidden(size.0, size.1);
        let ignored = self.ignored;
        (Self { all, ignored }, hidden)
    }

    /// Returns rows u, v, depth.
    fn table<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let rows = self.all.iter();
        let values = rows.flat_map(|point| [point.u, point.v, f64::from(point.depth)]);
        arrays::table(py, values.collect(), 3)
    }

    fn __len__(&self) -> usize {
        self.all.len()
    }
}

/// Converts a position on `from` pixels to `to` pixels of the same view.
fn rescaled(place: f64, from: usize, to: usize) -> f64 {
    (place + 0.5) * (to as f64 / from as f64) - 0.5
}
