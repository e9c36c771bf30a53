//! Images of a sequence with their poses.

use crate::camera::Camera;
use crate::error::{raised, raised_by_file};
use crate::observations::Observations;
use lsdc_core::{ViewOutcome, ViewSettings, ViewsOutcome, ViewsReport};
use numpy::PyReadonlyArray1;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// The measured points of an image, and its camera with the pose.
#[pyclass(frozen, module = "lsdc._native")]
pub(crate) struct PosedView(pub(crate) lsdc_core::PosedView);

#[pymethods]
impl PosedView {
    /// Creates the view of an image of this width and height; points with the same id are counted once.
    #[new]
    fn new(
        py: Python<'_>,
        camera: &Camera,
        size: (usize, usize),
        observations: &Observations,
        ids: Option<PyReadonlyArray1<'_, u64>>,
    ) -> PyResult<Self> {
        let camera = camera.0.resized(size);
        let camera = camera.map_err(|error| raised_by_file(py, &error))?;
        let view = lsdc_core::PosedView::new(camera, size.0, size.1, observations.all.clone());
        let view = view.map_err(|error| raised(py, &error))?;
        let Some(ids) = ids else {
            return Ok(Self(view));
        };
        let view = view.with_ids(ids.as_slice()?.to_vec());
        view.map(Self).map_err(|error| raised(py, &error))
    }
}

/// Returns the indices of the views that share most with one of them, best first.
#[pyfunction]
pub(crate) fn neighbours(
    py: Python<'_>,
    views: Vec<PyRef<'_, PosedView>>,
    index: usize,
    count: usize,
    only_past: bool,
) -> Vec<usize> {
    let views: Vec<lsdc_core::PosedView> = views.iter().map(|view| view.0.clone()).collect();
    let settings = ViewSettings {
        count,
        only_past,
        ..ViewSettings::default()
    };
    py.detach(|| lsdc_core::neighbours(&views, index, &settings))
}

/// Returns the report on the points of other views, by name.
pub(crate) fn described<'py>(
    py: Python<'py>,
    report: &ViewsReport,
) -> PyResult<Bound<'py, PyDict>> {
    let sum = |count: fn(&lsdc_core::ViewReport) -> usize| -> usize {
        report.views.iter().map(count).sum()
    };
    let outcome = match report.outcome {
        ViewsOutcome::Used => "used",
        ViewsOutcome::TooFewPoints => "too few points of its own",
        ViewsOutcome::Rejected => "rejected",
        _ => "no points",
    };
    let fields = PyDict::new(py);
    fields.set_item("outcome", outcome)?;
    fields.set_item("considered", report.views.len())?;
    fields.set_item("used", report.count(ViewOutcome::Used))?;
    fields.set_item("inconsistent", report.count(ViewOutcome::Inconsistent))?;
    fields.set_item("carried", report.carried())?;
    fields.set_item("occluded", sum(|view| view.occluded))?;
    fields.set_item("contradicting", sum(|view| view.contradicting))?;
    fields.set_item("doubled", sum(|view| view.doubled))?;
    fields.set_item("thinned", sum(|view| view.thinned))?;
    fields.set_item(
        "errors",
        report.errors.map(|[alone, together]| (alone, together)),
    )?;
    Ok(fields)
}
