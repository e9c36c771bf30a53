//! Conversion of results to arrays, which take over their memory.

use lsdc_core::DepthMap;
use numpy::{Element, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::prelude::*;

/// Converts a map to an array `(height, width)`.
pub(crate) fn map(py: Python<'_>, map: DepthMap) -> PyResult<Bound<'_, PyArray2<f32>>> {
    let shape = [map.height(), map.width()];
    PyArray1::from_vec(py, map.into_values()).reshape(shape)
}

/// Converts rows of `columns` values to an array `(rows, columns)`.
pub(crate) fn table<T: Element>(
    py: Python<'_>,
    values: Vec<T>,
    columns: usize,
) -> PyResult<Bound<'_, PyArray2<T>>> {
    let rows = values.len() / columns.max(1);
    PyArray1::from_vec(py, values).reshape([rows, columns])
}

/// Returns the rows of an array `(rows, N)`.
///
/// # Errors
/// The number of columns differs, or there are gaps between the values.
pub(crate) fn rows<'a, const N: usize>(
    array: &'a PyReadonlyArray2<'_, f64>,
) -> PyResult<&'a [[f64; N]]> {
    let (rows, rest) = array.as_slice()?.as_chunks::<N>();
    let columns = array.as_array().ncols();
    if columns == N && rest.is_empty() {
        Ok(rows)
    } else {
        let what = format!("{N} columns expected, not {columns}");
        Err(pyo3::exceptions::PyValueError::new_err(what))
    }
}
