//! TIFF images of one channel.

use super::{plausible, write_atomically};
use crate::data::DepthMap;
use crate::error::{Cause, Error, Result};
use std::fs::File;
use std::io::{BufReader, Cursor};
use std::path::Path;
use tiff::ColorType;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::encoder::TiffEncoder;
use tiff::encoder::colortype::Gray32Float;

/// Reads an image of one channel, integers or floats of any width, as depth: metres = value x
/// `scale`. Says too whether it holds integers.
pub(crate) fn read_tiff(path: &Path, scale: impl Fn(bool) -> f64) -> Result<(DepthMap, bool)> {
    let damaged = |e: tiff::TiffError| {
        Error::format(path, "is not a readable TIFF")
            .because(e)
            .hint("uncompressed, deflated and LZW files of one channel are read")
    };
    let file = File::open(path).map_err(|e| Error::read(path, e))?;
    let size = file.metadata().map_err(|e| Error::read(path, e))?.len();
    let mut decoder = Decoder::new(BufReader::new(file)).map_err(damaged)?;
    let (width, height) = decoder.dimensions().map_err(damaged)?;
    let ColorType::Gray(bits) = decoder.colortype().map_err(damaged)? else {
        return Err(Error::format(path, "has more than one channel")
            .hint("depths are images of one channel"));
    };
    let bytes = u64::from(width) * u64::from(height) * u64::from(bits.div_ceil(8));
    if !plausible(bytes, size) {
        return Err(Error::format(
            path,
            format!("declares {width}x{height} pixels but is only {size} bytes long"),
        ));
    }
    let mut limits = Limits::default();
    limits.decoding_buffer_size = bytes as usize;
    limits.intermediate_buffer_size = (bytes as usize).max(1 << 20);
    let image = decoder.with_limits(limits).read_image().map_err(damaged)?;
    let integers = !matches!(
        image,
        DecodingResult::F16(_) | DecodingResult::F32(_) | DecodingResult::F64(_)
    );
    let scale = scale(integers);
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
        integers,
    ))
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
