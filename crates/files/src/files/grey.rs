//! Depths in grey images: numbers as stored, never scaled to white.

use super::depth_png::declared_unit;
use super::picture::open;
use super::{check_pixels, chunks, pgm, read_tiff, refuse_window};
use crate::DepthMap;
use crate::checks::{NumberType, Warning};
use crate::error::{Error, Result};
use crate::raster::Raster;
use image::metadata::Orientation;
use png::{BitDepth, ColorType, Transformations};
use std::io::Cursor;
use std::path::Path;

/// Reads the numbers of a grey image of any bit depth: PNG or PGM, whatever its extension, or another format recognised by
/// its first bytes.
pub(crate) fn read_grey(path: &Path) -> Result<Raster> {
    let bytes = std::fs::read(path).map_err(|e| Error::read(path, e))?;
    match &bytes[..bytes.len().min(4)] {
        [0x89, b'P', b'N', b'G'] => read_png(path, &bytes),
        [b'P', b'1'..=b'7', ..] => pgm::read_pgm(path, &bytes),
        b"II*\0" | b"MM\0*" | b"II+\0" | b"MM\0+" => read_tiff(path),
        _ => {
            // JPEG, WebP and BMP have 8 bits, which the library does not scale.
            let image = open(path)?.0;
            if image.color().has_color() {
                return Err(pgm::colour(path));
            }
            let (columns, rows) = (image.width() as usize, image.height() as usize);
            let values = image.into_luma8().iter().map(|&v| f32::from(v)).collect();
            Ok(Raster::new(
                (columns, rows),
                values,
                NumberType::unsigned(8),
            ))
        }
    }
}

/// Reads a grey PNG as depth: metres = value x `scale`, 0 = no measurement, as are the values of
/// [`crate::checks::leave_out_marks`].
///
/// # Errors
/// The file is missing, damaged, or a colour image.
pub fn read_depth_png(path: &Path, scale: f64) -> Result<DepthMap> {
    let (depth, _) = read_grey(path)?.depth(scale)?;
    Ok(depth)
}

fn read_png(path: &Path, bytes: &[u8]) -> Result<Raster> {
    let damaged = |e: png::DecodingError| {
        Error::format(path, "is not a readable image")
            .because(e)
            .hint("the PNG is cut off or damaged; write it again")
    };
    let mut decoder = png::Decoder::new(Cursor::new(bytes));
    decoder.set_transformations(Transformations::IDENTITY);
    let mut reader = decoder.read_info().map_err(damaged)?;
    let info = reader.info();
    let samples = match info.color_type {
        ColorType::Grayscale => 1,
        ColorType::GrayscaleAlpha => 2,
        ColorType::Rgb | ColorType::Rgba | ColorType::Indexed => return Err(pgm::colour(path)),
    };
    refuse_window(path, chunks::offset(bytes), "chunk oFFs")?;
    let (width, height, depth) = (info.width, info.height, info.bit_depth);
    let exif = info
        .exif_metadata
        .clone()
        .and_then(|exif| Orientation::from_exif_chunk(&exif));
    let frames = chunks::frames(bytes);
    let plain = declared_unit(info).is_some();
    let transparent = info
        .trns
        .as_deref()
        .and_then(<[u8]>::first_chunk)
        .copied()
        .map(u16::from_be_bytes);
    let pixels = u64::from(width) * u64::from(height);
    let size = bytes.len() as u64;
    check_pixels(
        path,
        (width, height),
        pixels.saturating_mul(2 * samples),
        size,
    )?;
    let length = reader.output_buffer_size().unwrap_or_default();
    let mut packed = vec![0; length];
    let frame = reader.next_frame(&mut packed).map_err(damaged)?;
    let step = samples as usize;
    let values: Vec<u16> = match depth {
        BitDepth::Sixteen => {
            let words = packed.as_chunks::<2>().0.iter().step_by(step);
            words.map(|&word| u16::from_be_bytes(word)).collect()
        }
        BitDepth::Eight => packed.iter().step_by(step).map(|&v| u16::from(v)).collect(),
        _ => packed
            .chunks_exact(frame.line_size.max(1))
            .flat_map(|row| unpacked(row, depth as usize).take(width as usize))
            .collect(),
    };
    let size = (width as usize, height as usize);
    if values.len() != size.0 * size.1 {
        return Err(Error::format(path, "is not a readable image"));
    }
    let values = values.into_iter().map(f32::from).collect();
    let raster = Raster::new(size, values, NumberType::unsigned(depth as u32));
    let mut raster = raster.upright(exif.map_or(1, Orientation::to_exif));
    raster.declared = transparent.map(f64::from);
    raster.plain = plain;
    raster.warnings.extend(Warning::first("frame", frames));
    Ok(raster)
}

/// Unpacks the 1, 2 or 4-bit numbers of a row, the first in the highest bits.
fn unpacked(row: &[u8], bits: usize) -> impl Iterator<Item = u16> + '_ {
    let each = 8 / bits;
    let mask = (1_u16 << bits) - 1;
    row.iter().flat_map(move |&byte| {
        (0..each)
            .rev()
            .map(move |i| u16::from(byte) >> (i * bits) & mask)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{ExtendedColorType, ImageBuffer, ImageEncoder as _, LumaA};
    use std::path::PathBuf;

    fn in_folder(name: &str, bytes: &[u8]) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        (folder, path)
    }

    /// A grey PNG of these packed rows, with a chunk before the pixels.
    fn png(width: u32, height: u32, depth: BitDepth, rows: &[u8], chunk: Option<&[u8]>) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, width, height);
        encoder.set_color(ColorType::Grayscale);
        encoder.set_depth(depth);
        let mut writer = encoder.write_header().unwrap();
        if let Some(data) = chunk {
            writer
                .write_chunk(png::chunk::ChunkType(*b"oFFs"), data)
                .unwrap();
        }
        writer.write_image_data(rows).unwrap();
        writer.finish().unwrap();
        bytes
    }

    #[test]
    fn integers_of_any_bit_depth_are_as_stored() {
        for (depth, rows, expected) in [
            (
                BitDepth::One,
                &[0b1010_0000, 0b0100_0000][..],
                [1.0, 0.0, 1.0, 0.0, 1.0, 0.0],
            ),
            (
                BitDepth::Two,
                &[0b0001_1000, 0b1100_0100],
                [0.0, 1.0, 2.0, 3.0, 0.0, 1.0],
            ),
            (
                BitDepth::Four,
                &[0x12, 0x30, 0xa4, 0xf0],
                [1.0, 2.0, 3.0, 10.0, 4.0, 15.0],
            ),
            (
                BitDepth::Eight,
                &[1, 2, 3, 200, 5, 6],
                [1.0, 2.0, 3.0, 200.0, 5.0, 6.0],
            ),
            (
                BitDepth::Sixteen,
                &[0, 1, 1, 0, 2, 2, 0, 4, 0, 5, 255, 255],
                [1.0, 256.0, 514.0, 4.0, 5.0, 65535.0],
            ),
        ] {
            let (_folder, path) = in_folder("depth.png", &png(3, 2, depth, rows, None));
            let found = read_grey(&path).unwrap();
            assert_eq!((found.columns, found.rows), (3, 2));
            assert_eq!(found.values, expected, "{depth:?}");
            assert_eq!(found.numbers, NumberType::unsigned(depth as u32));
        }
    }

    #[test]
    fn a_window_of_a_larger_picture_is_refused() {
        let rows = [0, 1, 0, 2];
        let position = |x: i32, y: i32| [&x.to_be_bytes()[..], &y.to_be_bytes(), &[0]].concat();
        let (_folder, path) = in_folder(
            "a.png",
            &png(2, 1, BitDepth::Sixteen, &rows, Some(&position(40, 0))),
        );
        let error = read_grey(&path).unwrap_err().to_string();
        assert!(error.contains("window at 40, 0"), "{error}");
        let (_folder, path) = in_folder(
            "a.png",
            &png(2, 1, BitDepth::Sixteen, &rows, Some(&position(0, 0))),
        );
        assert_eq!(read_grey(&path).unwrap().values, [1.0, 2.0]);
    }

    #[test]
    fn transparency_and_exif_are_heeded_and_colour_is_refused() {
        let mut bytes = Vec::new();
        let mut encoder = image::codecs::png::PngEncoder::new(&mut bytes);
        // A TIFF directory of one tag: orientation 3, rotated by 180 degrees.
        let exif = [
            b'I', b'I', 42, 0, 8, 0, 0, 0, 1, 0, 0x12, 0x01, 3, 0, 1, 0, 0, 0, 3, 0, 0, 0, 0, 0, 0,
            0,
        ];
        encoder.set_exif_metadata(exif.to_vec()).unwrap();
        let pixels = [10, 255, 20, 255, 30, 0];
        encoder
            .write_image(&pixels, 3, 1, ExtendedColorType::La8)
            .unwrap();
        let (_folder, path) = in_folder("a.png", &bytes);
        assert_eq!(read_grey(&path).unwrap().values, [30.0, 20.0, 10.0]);
        let mut bytes = Cursor::new(Vec::new());
        let colours = image::RgbImage::new(2, 2);
        colours
            .write_to(&mut bytes, image::ImageFormat::Png)
            .unwrap();
        let (_folder, path) = in_folder("a.png", bytes.get_ref());
        let error = read_grey(&path).unwrap_err().to_string();
        assert!(error.contains("colour image"), "{error}");
    }

    #[test]
    fn transparency_does_not_scale_depths_of_8_bits() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("grey.png");
        let image: ImageBuffer<LumaA<u8>, Vec<u8>> =
            ImageBuffer::from_fn(4, 3, |x, _| LumaA([10 * x as u8, 255]));
        image.save(&path).unwrap();
        let found = read_grey(&path).unwrap();
        assert_eq!(found.numbers, NumberType::unsigned(8));
        assert_eq!(found.values[3 + 2 * 4], 30.0);
    }

    #[test]
    fn a_png_that_was_cut_off_is_refused() {
        let rows: Vec<u8> = (0..64 * 64 * 2).map(|i| (i * 7 % 251) as u8).collect();
        let whole = png(64, 64, BitDepth::Sixteen, &rows, None);
        for share in [0.1, 0.5, 0.9] {
            let (_folder, path) =
                in_folder("a.png", &whole[..(whole.len() as f64 * share) as usize]);
            assert!(read_grey(&path).is_err(), "{share}");
        }
    }
}
