//! Results as arrays, which take over the memory of the result.

use lsdc_core::DepthMap;
use numpy::{Element, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::prelude::*;

/// A map as an array `(height, width)`.
pub(crate) fn map(py: Python<'_>, map: DepthMap) -> PyResult<Bound<'_, PyArray2<f32>>> {
    let shape = [map.height(), map.width()];
    PyArray1::from_vec(py, map.into_values()).reshape(shape)
}

/// Rows of `columns` values as an array `(rows, columns)`.
pub(crate) fn table<T: Element>(
    py: Python<'_>,
    values: Vec<T>,
    columns: usize,
) -> PyResult<Bound<'_, PyArray2<T>>> {
    let rows = values.len() / columns.max(1);
    PyArray1::from_vec(py, values).reshape([rows, columns])
}

/// The rows of an array `(rows, N)`.
///
/// # Errors
/// Another number of columns, or gaps between the values.
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
