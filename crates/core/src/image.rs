//! Images in any memory layout.

use crate::error::{ImageError, Result};

/// Images and maps with more pixels are rejected.
pub const MAX_PIXELS: usize = 1 << 30;

/// The order of the colour channels of a pixel in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Channels {
    /// Red, green, blue.
    Rgb,
    /// Blue, green, red, as read by `OpenCV`.
    Bgr,
    /// Red, green, blue, and a fourth value that is ignored.
    Rgba,
    /// Blue, green, red, and a fourth value that is ignored.
    Bgra,
    /// A single grey value.
    Gray,
}

impl Channels {
    /// The number of values per pixel.
    pub fn count(self) -> usize {
        match self {
            Self::Gray => 1,
            Self::Rgb | Self::Bgr => 3,
            Self::Rgba | Self::Bgra => 4,
        }
    }

    /// The indices of red, green and blue in a pixel.
    fn indices(self) -> [usize; 3] {
        match self {
            Self::Gray => [0; 3],
            Self::Rgb | Self::Rgba => [0, 1, 2],
            Self::Bgr | Self::Bgra => [2, 1, 0],
        }
    }
}

#[derive(Clone, Copy, Debug)]
enum Values<'a> {
    Bytes(&'a [u8]),
    Floats(&'a [f32]),
}

impl Values<'_> {
    fn len(self) -> usize {
        match self {
            Self::Bytes(values) => values.len(),
            Self::Floats(values) => values.len(),
        }
    }
}

/// A colour image, borrowed from any buffer.
///
/// ```
/// use lsdc_core::{Channels, Image};
/// // A frame of 4x2 pixels as OpenCV holds it: BGR, rows padded to 16 bytes.
/// let bytes = [0_u8; 32];
/// let image = Image::new(4, 2, Channels::Bgr, &bytes)?.with_stride(16)?;
/// assert_eq!((image.width(), image.height()), (4, 2));
/// # Ok::<(), lsdc_core::Error>(())
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Image<'a> {
    values: Values<'a>,
    width: usize,
    height: usize,
    channels: Channels,
    /// Number of values from the start of one row to the next.
    stride: usize,
}

impl<'a> Image<'a> {
    /// An image with eight bits per channel, stored without gaps between rows.
    ///
    /// # Errors
    /// A side of 0, too many pixels, or a buffer that is too short.
    pub fn new(width: usize, height: usize, channels: Channels, bytes: &'a [u8]) -> Result<Self> {
        Self::of(width, height, channels, Values::Bytes(bytes))
    }

    /// An image of floats, with 0 for black and 1 for white, stored without gaps between rows. Values slightly out of this
    /// range are clamped; values above 16 are rejected when the image is used.
    ///
    /// # Errors
    /// A side of 0, too many pixels, or a buffer that is too short.
    pub fn from_f32(
        width: usize,
        height: usize,
        channels: Channels,
        values: &'a [f32],
    ) -> Result<Self> {
        Self::of(width, height, channels, Values::Floats(values))
    }

    fn of(width: usize, height: usize, channels: Channels, values: Values<'a>) -> Result<Self> {
        check_size(width, height)?;
        let image = Self {
            values,
            width,
            height,
            channels,
            stride: width * channels.count(),
        };
        image.with_stride(image.stride)
    }

    /// The same image with rows that start `stride` values apart.
    ///
    /// # Errors
    /// Rows that overlap, or a buffer that is too short.
    pub fn with_stride(self, stride: usize) -> Result<Self> {
        check_rows(
            self.width,
            self.height,
            self.channels.count(),
            stride,
            self.values.len(),
        )?;
        Ok(Self { stride, ..self })
    }

    /// Checks that nothing follows the last row: a longer buffer has other channels, or another stride.
    fn check_end(&self) -> Result<(), ImageError> {
        let found = self.values.len();
        let expected = self.stride.saturating_mul(self.height);
        if found <= expected {
            return Ok(());
        }
        let (width, height) = (self.width, self.height);
        Err(ImageError::Length {
            expected,
            found,
            width,
            height,
        })
    }

    /// Number of columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Returns red, green and blue of every pixel, 8 bits each, without gaps.
    ///
    /// # Errors
    /// Values after the last row, and floats that are not finite or far above 1.
    #[doc(hidden)]
    pub fn rgb(&self) -> Result<Vec<u8>> {
        /// Brighter colours indicate that the range is not 0 to 1.
        const BRIGHTEST: f32 = 16.0;
        self.check_end()?;
        let indices = self.channels.indices();
        let count = self.channels.count();
        let mut rgb = Vec::with_capacity(3 * self.width * self.height);
        for y in 0..self.height {
            let row = y * self.stride..y * self.stride + self.width * count;
            match self.values {
                Values::Bytes(values) if self.channels == Channels::Rgb => {
                    rgb.extend_from_slice(&values[row]);
                }
                Values::Bytes(values) => {
                    let pixels = values[row].chunks_exact(count);
                    rgb.extend(pixels.flat_map(|pixel| indices.map(|index| pixel[index])));
                }
                Values::Floats(values) => {
                    for (x, pixel) in values[row].chunks_exact(count).enumerate() {
                        for index in indices {
                            let value = pixel[index];
                            if !value.is_finite() {
                                return Err(ImageError::NotFinite { x, y }.into());
                            }
                            if value > BRIGHTEST {
                                return Err(ImageError::TooBright { x, y, value }.into());
                            }
                            rgb.push((value.clamp(0.0, 1.0) * 255.0).round() as u8);
                        }
                    }
                }
            }
        }
        Ok(rgb)
    }
}

/// Checks that a map of this size can be used.
pub(crate) fn check_size(width: usize, height: usize) -> Result<(), ImageError> {
    match width.checked_mul(height) {
        Some(1..=MAX_PIXELS) => Ok(()),
        _ => Err(ImageError::Size { width, height }),
    }
}

/// Checks that a map of this size can be used, and has `found` values.
pub(crate) fn check_length(width: usize, height: usize, found: usize) -> Result<(), ImageError> {
    check_size(width, height)?;
    if found == width * height {
        return Ok(());
    }
    Err(ImageError::Length {
        expected: width * height,
        found,
        width,
        height,
    })
}

/// Checks that `found` values hold rows of `width * channels` values, `stride` apart.
pub(crate) fn check_rows(
    width: usize,
    height: usize,
    channels: usize,
    stride: usize,
    found: usize,
) -> Result<(), ImageError> {
    let row = width * channels;
    if stride < row {
        return Err(ImageError::Stride { stride, row });
    }
    let expected = stride
        .checked_mul(height - 1)
        .and_then(|before| before.checked_add(row))
        .unwrap_or(usize::MAX);
    if found < expected {
        return Err(ImageError::Length {
            expected,
            found,
            width,
            height,
        });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buffers_of_another_shape_or_range_are_refused() {
        let bytes = [0; 18];
        assert!(
            Image::new(3, 2, Channels::Rgb, &bytes)
                .unwrap()
                .rgb()
                .is_ok()
        );
        // Colours passed as grey values, and a missing stride.
        assert!(
            Image::new(3, 2, Channels::Gray, &bytes)
                .unwrap()
                .rgb()
                .is_err()
        );
        let padded = Image::new(2, 2, Channels::Rgb, &bytes).unwrap();
        assert!(padded.rgb().is_err());
        assert!(padded.with_stride(9).unwrap().rgb().is_ok());
        let floats = [0.0, 1.1, 255.0];
        assert!(
            Image::from_f32(1, 1, Channels::Rgb, &floats)
                .unwrap()
                .rgb()
                .is_err()
        );
    }

    #[test]
    fn every_layout_gives_the_same_colours() {
        let rgb = [10_u8, 20, 30, 40, 50, 60];
        let image =
            |channels, bytes: &[u8]| Image::new(2, 1, channels, bytes).unwrap().rgb().unwrap();
        assert_eq!(image(Channels::Rgb, &rgb), rgb);
        assert_eq!(image(Channels::Bgr, &[30, 20, 10, 60, 50, 40]), rgb);
        assert_eq!(image(Channels::Rgba, &[10, 20, 30, 9, 40, 50, 60, 9]), rgb);
        assert_eq!(image(Channels::Bgra, &[30, 20, 10, 9, 60, 50, 40, 9]), rgb);
        assert_eq!(image(Channels::Gray, &[7, 8]), [7, 7, 7, 8, 8, 8]);
        let floats = rgb.map(|v| f32::from(v) / 255.0);
        let image = Image::from_f32(2, 1, Channels::Rgb, &floats).unwrap();
        assert_eq!(image.rgb().unwrap(), rgb);
    }

    #[test]
    fn rows_may_be_padded() {
        let bytes = [1, 2, 3, 99, 4, 5, 6];
        let image = Image::new(1, 2, Channels::Rgb, &bytes).unwrap();
        let image = image.with_stride(4).unwrap();
        assert_eq!(image.rgb().unwrap(), [1, 2, 3, 4, 5, 6]);
        assert!(image.with_stride(2).is_err());
        assert!(image.with_stride(5).is_err());
        assert!(image.with_stride(usize::MAX).is_err());
    }

    #[test]
    fn what_is_no_image_is_refused() {
        for (width, height) in [(0, 1), (1, 0), (usize::MAX, 2), (1 << 16, 1 << 16)] {
            assert!(Image::new(width, height, Channels::Rgb, &[0; 12]).is_err());
        }
        let dark = [0.0, f32::NAN, 0.0];
        let image = Image::from_f32(1, 1, Channels::Rgb, &dark).unwrap();
        assert!(matches!(
            image.rgb(),
            Err(crate::Error::Image(ImageError::NotFinite { x: 0, y: 0 }))
        ));
    }
}
