//! Depth predictions from another source.

use crate::error::{ExceptionKind, raised};
use lsdc_core::GuideKind;
use numpy::{PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

/// A dense depth prediction, used as additional basis functions.
#[pyclass(frozen, module = "lsdc._native")]
pub(crate) struct DepthGuide(pub(crate) lsdc_core::DepthGuide);

#[pymethods]
impl DepthGuide {
    #[new]
    fn new(py: Python<'_>, values: PyReadonlyArray2<'_, f32>, kind: &str) -> PyResult<Self> {
        let kind = match kind {
            "depth" => GuideKind::Depth,
            "disparity" => GuideKind::Disparity,
            "log" => GuideKind::Log,
            other => {
                let what = format!("`{other}` is not a kind of guide");
                let hint = "kinds: \"depth\", \"disparity\" (larger is nearer), \"log\"";
                return Err(ExceptionKind::Settings.raise(py, &what, Some(hint)));
            }
        };
        let (height, width) = (values.shape()[0], values.shape()[1]);
        let values = values.as_slice()?;
        let made = py.detach(|| lsdc_core::DepthGuide::new(kind, width, height, values));
        made.map(Self).map_err(|error| raised(py, &error))
    }

    #[getter]
    fn width(&self) -> usize {
        self.0.width()
    }

    #[getter]
    fn height(&self) -> usize {
        self.0.height()
    }

    #[getter]
    fn missing(&self) -> usize {
        self.0.missing()
    }
}
