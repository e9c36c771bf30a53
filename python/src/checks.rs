//! Checks of arrays by the same rules as files.

use image::{DynamicImage, ImageBuffer};
use lsdc_files::checks::{NumberFormat, NumberType, Warning, leave_out_marks, to_rgb8};
use numpy::{
    PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray2, PyReadonlyArray3,
    PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Returns the texts of warnings.
pub(crate) fn texts<'a>(warnings: impl IntoIterator<Item = &'a Warning>) -> Vec<String> {
    warnings.into_iter().map(ToString::to_string).collect()
}

/// Converts 16-bit colours `(H, W, 1 or 3)` to 8-bit `(H, W, 3)`, and returns remarks to be checked.
#[pyfunction]
pub(crate) fn eight_bits<'py>(
    py: Python<'py>,
    colours: PyReadonlyArray3<'py, u16>,
) -> PyResult<(Bound<'py, PyArray3<u8>>, Vec<String>)> {
    let [height, width, channels] = [0, 1, 2].map(|axis| colours.shape()[axis]);
    let values = colours.as_slice()?.to_vec();
    let (across, down) = (width as u32, height as u32);
    let image = match channels {
        1 => ImageBuffer::from_raw(across, down, values).map(DynamicImage::ImageLuma16),
        3 => ImageBuffer::from_raw(across, down, values).map(DynamicImage::ImageRgb16),
        _ => None,
    };
    let image = image.ok_or_else(|| PyValueError::new_err(format!("{channels} channels")))?;
    let (found, warning) = py.detach(|| to_rgb8(image));
    let found = PyArray1::from_vec(py, found.into_raw()).reshape([height, width, 3])?;
    Ok((found, texts(&warning)))
}

/// Replaces stored numbers that mark missing measurements by NaN, and returns remarks to be checked. `bits` is the size of
/// integers and whether they are signed; `metres` is the unit of one step.
#[pyfunction]
pub(crate) fn without_marks<'py>(
    py: Python<'py>,
    map: PyReadonlyArray2<'py, f32>,
    bits: Option<(u32, bool)>,
    metres: f64,
) -> PyResult<(Bound<'py, PyArray2<f32>>, Vec<String>)> {
    let [height, width] = [0, 1].map(|axis| map.shape()[axis]);
    let mut values = map.as_slice()?.to_vec();
    let known = NumberFormat {
        numbers: bits.map_or(NumberType::Floats, |(bits, signed)| NumberType::Integers {
            bits,
            signed,
        }),
        metres,
        declared: None,
    };
    let warnings = py.detach(|| leave_out_marks(&mut values, &known));
    let found = PyArray1::from_vec(py, values).reshape([height, width])?;
    Ok((found, texts(&warnings)))
}
