//! TIFF images of one channel.

use super::tags::Tags;
use super::{check_pixels, refuse_window, write_atomically};
use crate::DepthMap;
use crate::checks::{NumberType, Warning};
use crate::error::{Cause, Error, Result};
use crate::raster::Raster;
use std::fs::File;
use std::io::{BufReader, Cursor};
use std::path::Path;
use tiff::ColorType;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::encoder::TiffEncoder;
use tiff::encoder::colortype::Gray32Float;

/// Tags of TIFF 6.0, and of GDAL.
const PHOTOMETRIC: u64 = 262;
const ORIENTATION: u64 = 274;
const GDAL: u64 = 42112;
const NODATA: u64 = 42113;
/// Values of `PHOTOMETRIC`.
const WHITE_IS_ZERO: f64 = 0.0;
const BLACK_IS_ZERO: u16 = 1;

/// Reads the numbers of an image of one channel, integers or floats of 8 to 64 bits; the first of several pages.
pub(crate) fn read_tiff(path: &Path) -> Result<Raster> {
    let damaged = |e: tiff::TiffError| {
        Error::format(path, "is not a readable TIFF")
            .because(e)
            .hint("uncompressed, deflated and LZW files of one channel are read")
    };
    let mut bytes = std::fs::read(path).map_err(|e| Error::read(path, e))?;
    let size = bytes.len() as u64;
    let tags = Tags::of(path, &bytes)?;
    refuse_window(path, tags.offset(&bytes), "XPosition, YPosition")?;
    let item = |role| {
        let metadata = tags.text(GDAL, &bytes)?;
        gdal_item(metadata, role)?.parse::<f64>().ok()
    };
    let scale = item("scale").filter(|scale| *scale != 1.0);
    if let Some(offset) = item("offset").filter(|offset| *offset != 0.0) {
        let what = format!("holds depths less an offset of {offset} (metadata of GDAL)");
        return Err(Error::format(path, what)
            .hint("write the depths themselves (`gdal_translate -unscale`)"));
    }
    // The library would invert the numbers of such an image.
    if tags.number(PHOTOMETRIC, &bytes) == Some(WHITE_IS_ZERO)
        && let Some(value) = tags
            .short(PHOTOMETRIC)
            .and_then(|range| bytes.get_mut(range))
    {
        value.copy_from_slice(&tags.short_bytes(BLACK_IS_ZERO));
    }
    let mut decoder = Decoder::new(Cursor::new(&bytes)).map_err(damaged)?;
    let (width, height) = decoder.dimensions().map_err(damaged)?;
    let ColorType::Gray(bits) = decoder.colortype().map_err(damaged)? else {
        return Err(Error::format(path, "has more than one channel")
            .hint("depths are images of one channel"));
    };
    if !matches!(bits, 8 | 16 | 32 | 64) {
        return Err(Error::format(path, format!("holds numbers of {bits} bits"))
            .hint("depths of 8, 16, 32 and 64 bits are read"));
    }
    let area = u64::from(width) * u64::from(height);
    let length = area.saturating_mul(u64::from(bits / 8));
    check_pixels(path, (width, height), length, size)?;
    let mut limits = Limits::default();
    limits.decoding_buffer_size = length as usize;
    limits.intermediate_buffer_size = (length as usize).max(1 << 20);
    let image = decoder.with_limits(limits).read_image().map_err(damaged)?;
    macro_rules! floats {
        ($values:expr) => {
            $values.into_iter().map(|v| v as f32).collect()
        };
    }
    let (values, numbers): (Vec<f32>, _) = match image {
        DecodingResult::U8(v) => (floats!(v), NumberType::unsigned(8)),
        DecodingResult::U16(v) => (floats!(v), NumberType::unsigned(16)),
        DecodingResult::U32(v) => (floats!(v), NumberType::unsigned(32)),
        DecodingResult::U64(v) => (floats!(v), NumberType::unsigned(64)),
        DecodingResult::I8(v) => (floats!(v), NumberType::signed(8)),
        DecodingResult::I16(v) => (floats!(v), NumberType::signed(16)),
        DecodingResult::I32(v) => (floats!(v), NumberType::signed(32)),
        DecodingResult::I64(v) => (floats!(v), NumberType::signed(64)),
        DecodingResult::F16(v) => (v.into_iter().map(f32::from).collect(), NumberType::Floats),
        DecodingResult::F32(v) => (v, NumberType::Floats),
        DecodingResult::F64(v) => (floats!(v), NumberType::Floats),
    };
    let raster = Raster::new((width as usize, height as usize), values, numbers);
    let mut raster = raster.upright(tags.number(ORIENTATION, &bytes).unwrap_or(1.0) as u8);
    raster.declared = tags.text(NODATA, &bytes).and_then(|text| text.parse().ok());
    raster.warnings.extend(tags.chosen_page());
    raster.warnings.extend(scale.map(Warning::Scale));
    Ok(raster)
}

/// Returns the text of the first item with this role in the metadata of GDAL, which are XML: `<Item name="SCALE" sample="0"
/// role="scale">0.001</Item>`.
fn gdal_item<'a>(metadata: &'a str, role: &str) -> Option<&'a str> {
    let (_, after) = metadata.split_once(&format!("role=\"{role}\""))?;
    let (_, text) = after.split_once('>')?;
    text.split('<').next().map(str::trim)
}

/// Whether an image has one channel, so that it may contain depths.
pub(crate) fn is_grey_tiff(path: &Path) -> Result<bool> {
    check_tags(path)?;
    let file = File::open(path).map_err(|e| Error::read(path, e))?;
    let colour = Decoder::new(BufReader::new(file)).and_then(|mut decoder| decoder.colortype());
    Ok(matches!(colour, Ok(ColorType::Gray(_))))
}

/// Rejects tags with more numbers than the file has bytes.
pub(super) fn check_tags(path: &Path) -> Result<()> {
    let bytes = std::fs::read(path).map_err(|e| Error::read(path, e))?;
    Tags::of(path, &bytes).map(|_| ())
}

/// Writes depths as 32-bit floats in metres.
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

#[cfg(test)]
mod tests {
    use super::*;
    use tiff::encoder::colortype::Gray16;
    use tiff::tags::Tag;

    const STORED: [u16; 6] = [1, 2, 3, 4, 5, 6];

    /// An image of three columns and two rows with further tags.
    fn read(orientation: u16, metadata: Option<&str>) -> Result<Raster> {
        let mut bytes = Cursor::new(Vec::new());
        let mut file = TiffEncoder::new(&mut bytes).unwrap();
        let mut image = file.new_image::<Gray16>(3, 2).unwrap();
        image
            .encoder()
            .write_tag(Tag::Orientation, orientation)
            .unwrap();
        if let Some(metadata) = metadata {
            let tag = Tag::Unknown(GDAL as u16);
            image.encoder().write_tag(tag, metadata).unwrap();
        }
        image.write_data(&STORED).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.tif");
        std::fs::write(&path, bytes.into_inner()).unwrap();
        read_tiff(&path)
    }

    /// Rows of the table of TIFF 6.0, and the image that results.
    #[test]
    fn depths_are_turned_upright_by_the_orientation_tag() {
        for (orientation, columns, upright) in [
            (1, 3, [1, 2, 3, 4, 5, 6]),
            (2, 3, [3, 2, 1, 6, 5, 4]),
            (3, 3, [6, 5, 4, 3, 2, 1]),
            (4, 3, [4, 5, 6, 1, 2, 3]),
            (5, 2, [1, 4, 2, 5, 3, 6]),
            (6, 2, [4, 1, 5, 2, 6, 3]),
            (7, 2, [6, 3, 5, 2, 4, 1]),
            (8, 2, [3, 6, 2, 5, 1, 4]),
        ] {
            let found = read(orientation, None).unwrap();
            assert_eq!(
                (found.columns, found.rows),
                (columns, 6 / columns),
                "{orientation}"
            );
            assert_eq!(found.values, upright.map(|v| v as f32), "{orientation}");
        }
    }

    #[test]
    fn a_scale_of_gdal_is_reported_and_an_offset_refused() {
        let item = |name: &str, role: &str, value: &str| {
            format!(
                "<GDALMetadata>\n  <Item name=\"{name}\" sample=\"0\" role=\"{role}\">{value}</Item>\n</GDALMetadata>"
            )
        };
        let found = read(1, Some(&item("SCALE", "scale", "0.01"))).unwrap();
        assert_eq!(found.warnings, [Warning::Scale(0.01)]);
        for plain in [
            item("SCALE", "scale", "1"),
            item("OFFSET", "offset", "0"),
            item("AREA", "", "3"),
        ] {
            assert_eq!(read(1, Some(&plain)).unwrap().warnings, []);
        }
        let error = read(1, Some(&item("OFFSET", "offset", "1000"))).unwrap_err();
        assert!(error.to_string().contains("offset of 1000"), "{error}");
    }
}
