//! The body of `sensor_msgs/msg/Image`: rows of bytes that are not yet pixels.

use crate::cdr::{Reader, damaged};
use lsdc_files::error::{Error, Result};

/// An image before its pixels are looked at.
pub(super) struct Raw<'a> {
    pub(super) size: (usize, usize),
    pub(super) encoding: String,
    pub(super) big_endian: bool,
    /// Bytes from a row to the next.
    pub(super) step: usize,
    pub(super) data: &'a [u8],
}

impl<'a> Raw<'a> {
    pub(super) fn read(reader: &mut Reader<'a>) -> Result<Self> {
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

    /// The bytes of each row, of pixels of so many bytes.
    pub(super) fn rows(&self, pixel: usize) -> Result<impl Iterator<Item = &'a [u8]>> {
        self.rows_of(self.size.0, pixel)
    }

    /// The bytes of each row, which has so many groups of so many bytes.
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

    /// That there are fewer bytes than the pixels need.
    pub(super) fn too_short(&self) -> Error {
        let ((width, height), step) = (self.size, self.step);
        damaged(format!(
            "of {width}x{height} pixels ({}) and {step} bytes a row has {} bytes",
            self.encoding,
            self.data.len()
        ))
    }

    /// Pixels that are whole numbers of 16 bits.
    pub(super) fn whole(&self) -> Result<impl Iterator<Item = u16>> {
        let big = self.big_endian;
        let number = move |bytes: &[u8; 2]| {
            if big {
                u16::from_be_bytes(*bytes)
            } else {
                u16::from_le_bytes(*bytes)
            }
        };
        Ok(self.rows(2)?.flat_map(|row| row.as_chunks().0).map(number))
    }
}
