//! TIFF images of one channel.

use super::{Numbers, check_pixels, write_atomically};
use crate::DepthMap;
use crate::error::{Cause, Error, Result};
use std::fs::File;
use std::io::{BufReader, Cursor, Read as _, Seek as _, SeekFrom};
use std::path::Path;
use tiff::ColorType;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::encoder::TiffEncoder;
use tiff::encoder::colortype::Gray32Float;

/// Reads an image of one channel, integers or floats of any width, as depth: metres = value x
/// `scale` for such numbers. Says too which they are.
pub(crate) fn read_tiff(
    path: &Path,
    scale: impl Fn(Numbers) -> f64,
) -> Result<(DepthMap, Numbers)> {
    let damaged = |e: tiff::TiffError| {
        Error::format(path, "is not a readable TIFF")
            .because(e)
            .hint("uncompressed, deflated and LZW files of one channel are read")
    };
    check_tags(path)?;
    let file = File::open(path).map_err(|e| Error::read(path, e))?;
    let size = file.metadata().map_err(|e| Error::read(path, e))?.len();
    let mut decoder = Decoder::new(BufReader::new(file)).map_err(damaged)?;
    let (width, height) = decoder.dimensions().map_err(damaged)?;
    let ColorType::Gray(bits) = decoder.colortype().map_err(damaged)? else {
        return Err(Error::format(path, "has more than one channel")
            .hint("depths are images of one channel"));
    };
    let area = u64::from(width) * u64::from(height);
    let bytes = area.saturating_mul(u64::from(bits.div_ceil(8)));
    check_pixels(path, (width, height), bytes, size)?;
    let mut limits = Limits::default();
    limits.decoding_buffer_size = bytes as usize;
    limits.intermediate_buffer_size = (bytes as usize).max(1 << 20);
    let image = decoder.with_limits(limits).read_image().map_err(damaged)?;
    let numbers = match image {
        DecodingResult::F16(_) | DecodingResult::F32(_) | DecodingResult::F64(_) => Numbers::Floats,
        DecodingResult::U8(_) | DecodingResult::I8(_) => Numbers::Bytes,
        _ => Numbers::Integers,
    };
    let scale = scale(numbers);
    macro_rules! metres {
        ($values:expr) => {
            $values
                .into_iter()
                .map(|v| (f64::from(v) * scale) as f32)
                .collect()
        };
    }
    let values: Vec<f32> = match image {
        DecodingResult::U8(v) => metres!(v),
        DecodingResult::U16(v) => metres!(v),
        DecodingResult::U32(v) => metres!(v),
        DecodingResult::U64(v) => v.into_iter().map(|v| (v as f64 * scale) as f32).collect(),
        DecodingResult::I8(v) => metres!(v),
        DecodingResult::I16(v) => metres!(v),
        DecodingResult::I32(v) => metres!(v),
        DecodingResult::I64(v) => v.into_iter().map(|v| (v as f64 * scale) as f32).collect(),
        DecodingResult::F16(v) => metres!(v),
        DecodingResult::F32(v) => metres!(v),
        DecodingResult::F64(v) => metres!(v),
    };
    Ok((
        DepthMap::new(width as usize, height as usize, values)?,
        numbers,
    ))
}

/// Whether an image has one channel, and so may hold depths.
pub(crate) fn is_grey_tiff(path: &Path) -> Result<bool> {
    check_tags(path)?;
    let file = File::open(path).map_err(|e| Error::read(path, e))?;
    let colour = Decoder::new(BufReader::new(file)).and_then(|mut decoder| decoder.colortype());
    Ok(matches!(colour, Ok(ColorType::Gray(_))))
}

/// Refuses tags with more numbers than the file has bytes, for which the library makes room unread
/// (TIFF 6.0, section 2; `BigTIFF` has the same fields, wider).
pub(super) fn check_tags(path: &Path) -> Result<()> {
    let unreadable = |e| Error::read(path, e);
    let cut_off = |_| Error::format(path, "is cut off: it has no directory of tags");
    let mut file = BufReader::new(File::open(path).map_err(unreadable)?);
    let size = file.get_ref().metadata().map_err(unreadable)?.len();
    let mut head = [0; 16];
    file.read_exact(&mut head[..8]).map_err(cut_off)?;
    let little = head.starts_with(b"II");
    let number = |bytes: &[u8]| {
        let add = |value: u64, byte: &u8| value << 8 | u64::from(*byte);
        if little {
            bytes.iter().rev().fold(0, add)
        } else {
            bytes.iter().fold(0, add)
        }
    };
    let big = number(&head[2..4]) == 43;
    // Lengths of the count of tags, of a tag, and of its count of numbers.
    let (all, tag, count) = if big { (8, 20, 8) } else { (2, 12, 4) };
    let start = if big {
        file.read_exact(&mut head[8..]).map_err(cut_off)?;
        number(&head[8..])
    } else {
        number(&head[4..8])
    };
    file.seek(SeekFrom::Start(start)).map_err(cut_off)?;
    let mut bytes = [0; 20];
    file.read_exact(&mut bytes[..all]).map_err(cut_off)?;
    for _ in 0..number(&bytes[..all]) {
        file.read_exact(&mut bytes[..tag]).map_err(cut_off)?;
        let numbers = number(&bytes[4..4 + count]);
        if numbers > size {
            return Err(Error::format(
                path,
                format!("declares {numbers} numbers in a tag but is only {size} bytes long"),
            ));
        }
    }
    Ok(())
}

/// Writes 32-bit floats in metres.
///
/// # Errors
/// The file cannot be written.
pub fn write_tiff(path: &Path, depth: &DepthMap) -> Result<()> {
    let mut bytes = Cursor::new(Vec::new());
    let (width, height) = (depth.width() as u32, depth.height() as u32);
    TiffEncoder::new(&mut bytes)
        .and_then(|mut tiff| tiff.write_image::<Gray32Float>(width, height, depth.values()))
        .map_err(|e| {
            Error::new(Cause::Write, format!("cannot encode `{}`", path.display())).because(e)
        })?;
    write_atomically(path, |out| out.write_all(bytes.get_ref()))
}
