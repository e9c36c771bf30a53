//! Alignment of points with images.

use pyo3::prelude::*;

/// The evidence of one or more frames.
#[pyclass(frozen, module = "lsdc._native")]
pub(crate) struct Alignment(pub(crate) lsdc_core::Alignment);

/// u, v, error, error of the shifted points, standard errors, frames, and whether the shift is clear.
type Shift = (f64, f64, f64, f64, f64, usize, bool);

#[pymethods]
impl Alignment {
    #[getter]
    fn points(&self) -> usize {
        self.0.points()
    }

    #[pyo3(name = "with_")]
    fn with(&self, other: &Self) -> Self {
        let mut sum = self.0.clone();
        sum.add(&other.0);
        Self(sum)
    }

    fn shift(&self) -> Option<Shift> {
        let shift = self.0.shift()?;
        Some((
            shift.u,
            shift.v,
            shift.error,
            shift.error_moved,
            shift.standard_errors,
            shift.frames,
            shift.is_clear(),
        ))
    }
}
