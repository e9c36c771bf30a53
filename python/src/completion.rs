//! A scene fitted to observations.

use crate::arrays;
use crate::camera::Camera;
use crate::error::raised_by_file;
use crate::pool::Pool;
use image::RgbImage;
use lsdc_files::{CloudOptions, ColoredCloud, DeviationLimits, are_far};
use numpy::{PyArray1, PyArray2, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::Arc;

/// A fit and its results.
#[pyclass(frozen, module = "lsdc._native")]
pub(crate) struct Completion {
    inner: lsdc_core::Completion,
    /// Colours of the image.
    colours: Arc<RgbImage>,
    pool: Pool,
}

impl Completion {
    pub(crate) fn new(inner: lsdc_core::Completion, colours: Arc<RgbImage>, pool: Pool) -> Self {
        Self {
            inner,
            colours,
            pool,
        }
    }
}

/// Rows x, y, z (float32, or float64 far from the origin), colours, standard deviations, and the numbers of pixels that are
/// uncertain, unseen, flying and merged.
type PointCloud<'py> = (
    Bound<'py, PyAny>,
    Bound<'py, PyArray2<u8>>,
    Option<Bound<'py, PyArray1<f32>>>,
    [usize; 4],
);

/// Index, probability, score, error and weight of every outlier.
type Outliers<'py> = (
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
);

#[pymethods]
impl Completion {
    fn depth_at<'py>(
        &self,
        py: Python<'py>,
        width: usize,
        height: usize,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let map = self.pool.run(py, || self.inner.depth_at(width, height))?;
        arrays::map(py, map)
    }

    fn standard_deviation_at<'py>(
        &self,
        py: Python<'py>,
        width: usize,
        height: usize,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let map = self
            .pool
            .run(py, || self.inner.standard_deviation_at(width, height))?;
        arrays::map(py, map)
    }

    /// Returns the pixels of a map of this width and height as a point cloud. Without `max_sigma`, standard deviations may be
    /// missing, if there are too few points for an estimate.
    fn point_cloud<'py>(
        &self,
        py: Python<'py>,
        camera: &Camera,
        size: (usize, usize),
        max_sigma: Option<f32>,
        max_relative_sigma: Option<f32>,
        voxel: Option<f64>,
        keep_flying: bool,
    ) -> PyResult<PointCloud<'py>> {
        let (width, height) = size;
        let image = (
            self.colours.width() as usize,
            self.colours.height() as usize,
        );
        let camera = camera.0.resized(image);
        let camera = camera.map_err(|error| raised_by_file(py, &error))?;
        let options = CloudOptions {
            limits: DeviationLimits {
                absolute: max_sigma,
                relative: max_relative_sigma,
            },
            keep_flying,
            voxel,
        };
        let cloud = self.pool.run(py, || {
            let depth = self.inner.depth_at(width, height)?;
            let sigma = match self.inner.standard_deviation_at(width, height) {
                Err(error) if max_sigma.is_some() => return Err(error),
                found => found.ok(),
            };
            Ok(ColoredCloud::new(
                &depth,
                sigma.as_ref(),
                &self.colours,
                &camera,
                &options,
            ))
        })?;
        let all = &cloud.points;
        let places = all.iter().flat_map(|point| point.position);
        let places = if are_far(all) {
            arrays::table(py, places.collect(), 3)?.into_any()
        } else {
            arrays::table(py, places.map(|v| v as f32).collect(), 3)?.into_any()
        };
        let colours = all.iter().flat_map(|point| point.color).collect();
        // All points have a standard deviation, or none has.
        let sigma: Option<Vec<f32>> = all.iter().map(|point| point.sigma).collect();
        Ok((
            places,
            arrays::table(py, colours, 3)?,
            sigma.map(|sigma| PyArray1::from_vec(py, sigma)),
            [cloud.uncertain, cloud.unseen, cloud.flying, cloud.merged],
        ))
    }

    /// Returns the depth at rows u, v.
    fn at<'py>(
        &self,
        py: Python<'py>,
        places: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Bound<'py, PyArray1<f32>>> {
        let places = arrays::rows::<2>(&places)?;
        let depths = self.pool.run(py, || self.inner.at(places))?;
        Ok(PyArray1::from_vec(py, depths))
    }

    fn residuals<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let found = self.pool.run(py, || Ok(self.inner.residuals()))?;
        Ok(PyArray1::from_vec(py, found))
    }

    fn leave_one_out<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let found = self.pool.run(py, || Ok(self.inner.leave_one_out()))?;
        Ok(PyArray1::from_vec(py, found))
    }

    fn leave_one_out_error(&self, py: Python<'_>) -> PyResult<Option<f64>> {
        self.pool.run(py, || Ok(self.inner.leave_one_out_error()))
    }

    fn point_weights<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_vec(py, self.inner.point_weights())
    }

    fn outliers<'py>(&self, py: Python<'py>) -> PyResult<Outliers<'py>> {
        let found = self.pool.run(py, || self.inner.outliers())?;
        let of = |value: fn(&lsdc_core::Outlier) -> f64| {
            PyArray1::from_vec(py, found.iter().map(value).collect())
        };
        let index = found.iter().map(|outlier| outlier.index as i64).collect();
        Ok((
            PyArray1::from_vec(py, index),
            of(|outlier| outlier.probability),
            of(|outlier| outlier.score),
            of(|outlier| outlier.error),
            of(|outlier| outlier.weight),
        ))
    }

    fn weights<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, self.inner.weights())
    }

    fn limits(&self) -> (f32, f32) {
        self.inner.limits()
    }

    fn interval(&self, py: Python<'_>, level: f64) -> PyResult<f64> {
        self.pool.run(py, || self.inner.interval(level))
    }

    fn sky_pixels(&self, py: Python<'_>) -> PyResult<usize> {
        self.pool.run(py, || Ok(self.inner.sky_pixels()))
    }

    fn freedom(&self) -> Option<f64> {
        self.inner.freedom()
    }

    /// Returns the fields of the report by name, with times in seconds.
    fn report<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let report = self.inner.report();
        let fields = PyDict::new(py);
        fields.set_item("given", report.given)?;
        fields.set_item("used", report.used)?;
        fields.set_item("invalid", report.invalid)?;
        fields.set_item("outside", report.outside)?;
        fields.set_item("without_deviation", report.without_deviation)?;
        fields.set_item("smoothed", report.smoothed)?;
        fields.set_item("limited", report.limited)?;
        fields.set_item("method", report.method.name())?;
        fields.set_item("residual", report.residual)?;
        fields.set_item("rank", report.rank)?;
        fields.set_item("functions", report.functions)?;
        fields.set_item("lambda", report.lambda)?;
        fields.set_item("guide_trust", report.guide_trust)?;
        fields.set_item("median_share", report.median_share)?;
        fields.set_item("network", report.network.as_secs_f64())?;
        fields.set_item("fit", report.fit.as_secs_f64())?;
        fields.set_item("field", report.field.as_secs_f64())?;
        fields.set_item("solve", report.solve.as_secs_f64())?;
        Ok(fields)
    }
}
