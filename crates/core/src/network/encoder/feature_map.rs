//! Encoding of images of any size.

use super::{Encoder, PATCH};
use crate::depth_anything::DepthAnything;
use crate::error::{FitError, Result, SettingsError};
use crate::resize::resized_cubic;

/// The size of the images that an encoder reads, whatever their aspect ratio: the shorter side of one of 4:3 with as many pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EncoderSide(usize);

impl Default for EncoderSide {
    /// That of training.
    fn default() -> Self {
        Self(DepthAnything::SHORT_SIDE)
    }
}

impl EncoderSide {
    /// A side in pixels, one of [`DepthAnything::SHORT_SIDES`].
    ///
    /// # Errors
    /// Another side.
    pub fn new(side: usize) -> Result<Self, SettingsError> {
        DepthAnything::check_short_side(side)?;
        Ok(Self(side))
    }

    /// Rows and columns of patches for an image of a height and width.
    pub fn patches(self, (height, width): (usize, usize)) -> (usize, usize) {
        let patches = 4.0 / 3.0 * (self.0 as f64 / PATCH as f64).powi(2);
        let aspect = height as f64 / width.max(1) as f64;
        let count = |length: f64| (length.round() as usize).clamp(1, patches as usize);
        (
            count((patches * aspect).sqrt()),
            count((patches / aspect).sqrt()),
        )
    }
}

/// The features of an image, as a map.
#[derive(Clone, Debug, PartialEq)]
pub struct FeatureMap {
    /// Patches down.
    pub rows: usize,
    /// Patches across.
    pub columns: usize,
    /// Features of all taps, concatenated: `[rows, columns, channels]`.
    pub values: Vec<f32>,
}

/// Resizes a normalised image `[height, width, 3]` to whole patches by cubic convolution, and returns it with the rows and
/// columns of patches.
///
/// # Errors
/// An image without pixels, or another number of values.
pub fn in_patches(
    image: &[f32],
    size: (usize, usize),
    side: EncoderSide,
) -> Result<(Vec<f32>, (usize, usize))> {
    if size.0 * size.1 == 0 || image.len() != 3 * size.0 * size.1 {
        let (count, (height, width)) = (image.len(), size);
        let what = format!("{count} values are no image of {width}x{height} pixels");
        return Err(FitError::Shape(what).into());
    }
    let (rows, columns) = side.patches(size);
    let image = resized_cubic(image, size, (rows * PATCH, columns * PATCH))?;
    Ok((image, (rows, columns)))
}

impl Encoder {
    /// Encodes a normalised image `[height, width, 3]` of any size. It is resized to whole patches by cubic convolution.
    ///
    /// # Errors
    /// An image without pixels, or another number of values.
    pub fn encode(
        &self,
        image: &[f32],
        size: (usize, usize),
        side: EncoderSide,
    ) -> Result<FeatureMap> {
        let (image, (rows, columns)) = in_patches(image, size, side)?;
        let features = self.features(&image, (rows * PATCH, columns * PATCH))?;
        let width = self.config().width;
        let mut values = Vec::with_capacity(rows * columns * self.config().channels());
        for patch in 0..rows * columns {
            for tap in &features.taps {
                values.extend_from_slice(&tap[patch * width..][..width]);
            }
        }
        Ok(FeatureMap {
            rows,
            columns,
            values,
        })
    }
}
