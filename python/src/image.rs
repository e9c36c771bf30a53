//! Arrays as images.

use crate::error::raised;
use image::RgbImage;
use lsdc_core::{Channels, Image, Result};
use numpy::{PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;

/// Colours from Python, borrowed: `(height, width, channels)`.
#[derive(FromPyObject)]
pub(crate) enum Colours<'py> {
    Bytes(PyReadonlyArray3<'py, u8>),
    Floats(PyReadonlyArray3<'py, f32>),
}

impl Colours<'_> {
    /// Returns the image of these colours, with blue first if `bgr`.
    ///
    /// # Errors
    /// The number of channels or the size is not that of an image.
    pub(crate) fn image(&self, py: Python<'_>, bgr: bool) -> PyResult<Image<'_>> {
        let shape = match self {
            Self::Bytes(array) => array.shape(),
            Self::Floats(array) => array.shape(),
        };
        let (height, width) = (shape[0], shape[1]);
        let channels = match (shape[2], bgr) {
            (1, _) => Channels::Gray,
            (3, false) => Channels::Rgb,
            (3, true) => Channels::Bgr,
            (4, false) => Channels::Rgba,
            (4, true) => Channels::Bgra,
            (count, _) => {
                let what = format!("{count} channels");
                return Err(pyo3::exceptions::PyValueError::new_err(what));
            }
        };
        let image: Result<Image<'_>> = match self {
            Self::Bytes(array) => Image::new(width, height, channels, array.as_slice()?),
            Self::Floats(array) => Image::from_f32(width, height, channels, array.as_slice()?),
        };
        image.map_err(|error| raised(py, &error))
    }
}

/// Copies the colours of an image, for clouds.
pub(crate) fn copy(image: &Image<'_>) -> Result<RgbImage> {
    let (width, height) = (image.width() as u32, image.height() as u32);
    let colours = RgbImage::from_raw(width, height, image.rgb()?);
    // The number of colours matches the size.
    Ok(colours.unwrap_or_default())
}
