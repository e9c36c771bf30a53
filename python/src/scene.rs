//! The network output for one image.

use crate::alignment::Alignment;
use crate::arrays;
use crate::completion::Completion;
use crate::error::ExceptionKind;
use crate::guide::DepthGuide;
use crate::observations::Observations;
use crate::pool::Pool;
use crate::settings::robust;
use crate::views::{PosedView, described};
use image::RgbImage;
use lsdc_core::ViewSettings;
use numpy::{PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::Arc;

/// The basis functions and affinities of an image.
#[pyclass(frozen, module = "lsdc._native")]
pub(crate) struct Scene {
    inner: lsdc_core::Scene,
    colours: Arc<RgbImage>,
    pool: Pool,
}

impl Scene {
    pub(crate) fn new(inner: lsdc_core::Scene, colours: Arc<RgbImage>, pool: Pool) -> Self {
        Self {
            inner,
            colours,
            pool,
        }
    }

    /// Replaces the scene of the same image.
    fn with(&self, inner: lsdc_core::Scene) -> Self {
        Self::new(inner, self.colours.clone(), self.pool.clone())
    }
}

#[pymethods]
impl Scene {
    #[getter]
    fn width(&self) -> usize {
        self.inner.width()
    }

    #[getter]
    fn height(&self) -> usize {
        self.inner.height()
    }

    /// Run time of the network in seconds.
    #[getter]
    fn network_time(&self) -> f64 {
        self.inner.network_time().as_secs_f64()
    }

    /// Returns the scene with other robust settings, as JSON.
    fn with_robust(&self, py: Python<'_>, settings: &str) -> PyResult<Self> {
        let refused = |why: String| {
            ExceptionKind::Settings.raise(py, &format!("the settings of robustness: {why}"), None)
        };
        let settings = serde_json::from_str(settings).map_err(|why| refused(why.to_string()))?;
        let settings = robust(settings).map_err(refused)?;
        let inner = self.pool.run(py, || self.inner.with_robust(settings))?;
        Ok(self.with(inner))
    }

    /// Returns the scene with another guide, or none.
    fn with_guide(&self, guide: Option<&DepthGuide>) -> Self {
        self.with(self.inner.with_guide(guide.map(|guide| &guide.0)))
    }

    /// Fits the scene to observations. `near` contains weights of another fit.
    fn complete(
        &self,
        py: Python<'_>,
        observations: &Observations,
        near: Option<PyReadonlyArray1<'_, f64>>,
    ) -> PyResult<Completion> {
        let near = near.as_ref().map(|near| near.as_slice()).transpose()?;
        let all = &observations.all;
        let inner = self.pool.run(py, || match near {
            None => self.inner.complete(all),
            Some(near) => self.inner.complete_near(all, near),
        })?;
        Ok(Completion::new(
            inner,
            self.colours.clone(),
            self.pool.clone(),
        ))
    }

    /// Fits the scene to observations and at most `max_points` points of other views, and returns a report on these.
    fn complete_with_views<'py>(
        &self,
        py: Python<'py>,
        own: &PosedView,
        others: Vec<PyRef<'_, PosedView>>,
        max_points: usize,
    ) -> PyResult<(Completion, Bound<'py, PyDict>)> {
        let others: Vec<lsdc_core::PosedView> = others.iter().map(|view| view.0.clone()).collect();
        let others: Vec<&lsdc_core::PosedView> = others.iter().collect();
        let settings = ViewSettings {
            max_points,
            ..ViewSettings::default()
        };
        let (inner, report) = self.pool.run(py, || {
            self.inner.complete_with_views(&own.0, &others, &settings)
        })?;
        let completion = Completion::new(inner, self.colours.clone(), self.pool.clone());
        Ok((completion, described(py, &report)?))
    }

    /// Returns the evidence of this frame for a shift between points and image.
    fn alignment(&self, py: Python<'_>, observations: &Observations) -> PyResult<Alignment> {
        let found = self
            .pool
            .run(py, || self.inner.alignment(&observations.all))?;
        Ok(Alignment(found))
    }

    /// Returns the basis functions `(places, functions)` at rows u, v.
    fn basis_functions<'py>(
        &self,
        py: Python<'py>,
        places: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let places = arrays::rows::<2>(&places)?;
        let values = self
            .pool
            .run(py, || Ok(self.inner.basis_functions(places)))?;
        let columns = values.len() / places.len().max(1);
        arrays::table(py, values, columns)
    }
}
