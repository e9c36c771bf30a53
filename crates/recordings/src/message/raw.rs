//! The body of `sensor_msgs/msg/Image`: rows of bytes that are not yet pixels.

use crate::cdr::{CdrReader, damaged};
use lsdc_files::error::{Error, Result};

/// An image whose pixels have not been decoded.
pub(super) struct Raw<'a> {
    pub(super) size: (usize, usize),
    pub(super) encoding: String,
    pub(super) big_endian: bool,
    /// Bytes from one row to the next.
    pub(super) step: usize,
    pub(super) data: &'a [u8],
}

impl<'a> Raw<'a> {
    pub(super) fn read(reader: &mut CdrReader<'a>) -> Result<Self> {
        let [height, width] = [reader.u32()?, reader.u32()?].map(|v| v as usize);
        let encoding = reader.string()?;
        let (big_endian, step) = (reader.u8()? != 0, reader.u32()? as usize);
        Ok(Self {
            size: (width, height),
            encoding,
            big_endian,
            step,
            data: reader.bytes()?,
        })
    }

    /// Returns the bytes of each row, of pixels of `pixel` bytes.
    pub(super) fn rows(&self, pixel: usize) -> Result<impl Iterator<Item = &'a [u8]>> {
        self.rows_of(self.size.0, pixel)
    }

    /// Returns the bytes of each row, which has `groups` groups of `bytes` bytes.
    pub(super) fn rows_of(
        &self,
        groups: usize,
        bytes: usize,
    ) -> Result<impl Iterator<Item = &'a [u8]>> {
        let (data, step, height) = (self.data, self.step, self.size.1);
        let long = groups.checked_mul(bytes).filter(|long| *long <= step);
        let all = long.and_then(|long| step.checked_mul(height.checked_sub(1)?)?.checked_add(long));
        match (long, all) {
            (Some(long), Some(all)) if long > 0 && all <= data.len() => {
                Ok((0..height).map(move |row| &data[row * step..row * step + long]))
            }
            _ => Err(self.too_short()),
        }
    }

    /// Error of an image with fewer bytes than its pixels need.
    pub(super) fn too_short(&self) -> Error {
        let ((width, height), step) = (self.size, self.step);
        damaged(format!(
            "of {width}x{height} pixels ({}) and {step} bytes a row has {} bytes",
            self.encoding,
            self.data.len()
        ))
    }

    /// Decodes pixels of one number each, by its conversions from big-endian and little-endian bytes.
    pub(super) fn numbers<T, const N: usize>(
        &self,
        from_be: impl Fn([u8; N]) -> T,
        from_le: impl Fn([u8; N]) -> T,
    ) -> Result<impl Iterator<Item = T>> {
        let big = self.big_endian;
        let number = move |bytes: &[u8; N]| {
            if big {
                from_be(*bytes)
            } else {
                from_le(*bytes)
            }
        };
        let pixels = self.rows(N)?.flat_map(|row| row.as_chunks::<N>().0);
        Ok(pixels.map(number))
    }

    /// Decodes pixels that are 16-bit integers.
    pub(super) fn numbers_u16(&self) -> Result<impl Iterator<Item = u16>> {
        self.numbers(u16::from_be_bytes, u16::from_le_bytes)
    }
}
