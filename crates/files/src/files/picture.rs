//! Colour images.

use super::tags::Tags;
use super::tiff::check_tags;
use super::{check_pixels, chunks, write_atomically};
use crate::Orientation;
use crate::checks::{Warning, check_jpeg, to_rgb8};
use crate::error::{Error, Result};
use crate::foreign::check_foreign;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{
    ColorType, DynamicImage, ImageDecoder, ImageError, ImageFormat, ImageReader, RgbImage,
};
use std::fs::File;
use std::io::{BufRead, BufReader, Cursor, Seek};
use std::path::Path;

/// A colour image, turned upright.
#[derive(Clone, Debug)]
pub struct UprightImage {
    /// Pixels, turned upright by the EXIF record.
    pub rgb: RgbImage,
    /// Applied orientation.
    pub orientation: Orientation,
    /// Warnings about the image.
    pub warnings: Vec<Warning>,
}

/// Reads a JPEG, PNG, WebP, TIFF, BMP or PNM as 8-bit RGB, turned upright by its EXIF record.
///
/// # Errors
/// The file is missing, damaged or of an unknown format.
pub fn read_rgb(path: &Path) -> Result<RgbImage> {
    read_upright(path).map(|image| image.rgb)
}

/// [`read_rgb`] with the orientation and the warnings.
///
/// # Errors
/// The file is missing, damaged or of an unknown format.
pub fn read_upright(path: &Path) -> Result<UprightImage> {
    let (image, orientation, mut warnings) = open(path)?;
    let (rgb, warning) = to_rgb8(image);
    warnings.extend(warning);
    Ok(UprightImage {
        rgb,
        orientation,
        warnings,
    })
}

/// Writes an 8-bit colour PNG.
///
/// # Errors
/// The file cannot be written.
pub fn write_rgb(path: &Path, image: &RgbImage) -> Result<()> {
    write_atomically(path, |out| {
        // Trying every filter on each row saves too little for its time.
        let encoder = PngEncoder::new_with_quality(out, CompressionType::Fast, FilterType::Up);
        image.write_with_encoder(encoder).map_err(|e| match e {
            ImageError::IoError(e) => e,
            other => std::io::Error::other(other),
        })
    })
}

/// Returns width and height of an image as stored, reading only its header.
///
/// # Errors
/// The file is missing or of an unknown format, or its header is damaged.
pub fn image_size(path: &Path) -> Result<(usize, usize)> {
    image_kind(path).map(|(size, _)| size)
}

/// Returns the stored size and the orientation of an image, reading only its header.
///
/// # Errors
/// As for [`image_size`].
pub fn image_orientation(path: &Path) -> Result<Orientation> {
    let file = File::open(path).map_err(|e| Error::read(path, e))?;
    let size = file.metadata().map_err(|e| Error::read(path, e))?.len();
    let mut decoder = decoder(path, BufReader::new(file), size)?;
    let exif = decoder.orientation().map_err(|e| damaged(path, e))?;
    let (width, height) = decoder.dimensions();
    Ok(Orientation::new(
        (width as usize, height as usize),
        exif.to_exif(),
    ))
}

/// Returns width, height and colour type, as stored.
pub(crate) fn image_kind(path: &Path) -> Result<((usize, usize), ColorType)> {
    let file = File::open(path).map_err(|e| Error::read(path, e))?;
    let size = file.metadata().map_err(|e| Error::read(path, e))?.len();
    let decoder = decoder(path, BufReader::new(file), size)?;
    let (width, height) = decoder.dimensions();
    Ok(((width as usize, height as usize), decoder.color_type()))
}

/// Returns whether an image contains depths, which have one channel of 16 bits.
///
/// # Errors
/// As for [`image_size`].
pub fn is_depth_image(path: &Path) -> Result<bool> {
    image_kind(path).map(|(_, kind)| kind == ColorType::L16)
}

/// Decodes an image, turned upright, with its orientation and warnings about the rest of the file.
pub(super) fn open(path: &Path) -> Result<(DynamicImage, Orientation, Vec<Warning>)> {
    let bytes = std::fs::read(path).map_err(|e| Error::read(path, e))?;
    check_jpeg(&bytes).map_err(|cut_off| {
        Error::format(path, "is not a readable image")
            .because(cut_off)
            .hint("the file is incomplete; copy or write it again")
    })?;
    let warnings = container_warnings(path, &bytes)?;
    let mut decoder = decoder(path, Cursor::new(&bytes), bytes.len() as u64)?;
    let damaged = |e: ImageError| damaged(path, e);
    let exif = decoder.orientation().map_err(damaged)?;
    let mut image = DynamicImage::from_decoder(decoder).map_err(damaged)?;
    let size = (image.width() as usize, image.height() as usize);
    image.apply_orientation(exif);
    Ok((image, Orientation::new(size, exif.to_exif()), warnings))
}

/// Returns warnings about further pages and frames, and about an offset in a larger picture.
fn container_warnings(path: &Path, bytes: &[u8]) -> Result<Vec<Warning>> {
    let (several, offset) = if matches!(image::guess_format(bytes), Ok(ImageFormat::Tiff)) {
        let tags = Tags::of(path, bytes)?;
        (tags.chosen_page(), tags.offset(bytes))
    } else {
        (
            Warning::first("frame", chunks::frames(bytes)),
            chunks::offset(bytes),
        )
    };
    let offset = offset.map(|position| Warning::Offset { position });
    Ok(several.into_iter().chain(offset).collect())
}

fn damaged(path: &Path, cause: ImageError) -> Error {
    Error::format(path, "is not a readable image")
        .because(cause)
        .hint("JPEG, PNG, WebP, TIFF, BMP and PNM are read; check that the file is complete")
}

/// Returns the decoder of an image of `size` bytes, by its first bytes or else its extension.
fn decoder<'a, R>(path: &Path, from: R, size: u64) -> Result<impl ImageDecoder + 'a>
where
    R: BufRead + Seek + 'a,
{
    let mut reader = ImageReader::new(from);
    if let Ok(format) = ImageFormat::from_path(path) {
        reader.set_format(format);
    }
    let reader = reader
        .with_guessed_format()
        .map_err(|e| Error::read(path, e))?;
    if reader.format() == Some(ImageFormat::Tiff) {
        check_tags(path)?;
    }
    let decoder = reader.into_decoder().map_err(|e| {
        let foreign = check_foreign(path).err();
        foreign.unwrap_or_else(|| damaged(path, e))
    })?;
    check_pixels(path, decoder.dimensions(), decoder.total_bytes(), size)?;
    Ok(decoder)
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{ImageBuffer, ImageEncoder as _, Rgb};

    /// An EXIF record with only an orientation: a TIFF directory of one tag.
    fn exif(orientation: u8) -> Vec<u8> {
        let head = [b'I', b'I', 42, 0, 8, 0, 0, 0, 1, 0];
        let tag = [0x12, 0x01, 3, 0, 1, 0, 0, 0, orientation, 0, 0, 0];
        [&head[..], &tag, &[0; 4]].concat()
    }

    #[test]
    fn images_are_turned_as_exif_says() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("turned.png");
        let image = RgbImage::from_fn(5, 3, |x, y| Rgb([x as u8, y as u8, 7]));
        for orientation in 1..=8 {
            let mut file = Vec::new();
            let mut encoder = PngEncoder::new(&mut file);
            encoder.set_exif_metadata(exif(orientation)).unwrap();
            image.write_with_encoder(encoder).unwrap();
            std::fs::write(&path, file).unwrap();
            let UprightImage {
                rgb: upright,
                orientation: found,
                ..
            } = read_upright(&path).unwrap();
            assert_eq!(found, Orientation::new((5, 3), orientation));
            for (x, y, pixel) in image.enumerate_pixels() {
                let [u, v] = found.turned([f64::from(x), f64::from(y)]);
                assert_eq!(upright.get_pixel(u as u32, v as u32), pixel);
            }
        }
    }

    #[test]
    fn a_jpeg_that_was_cut_off_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("photo.jpg");
        let photo = RgbImage::from_fn(64, 64, |x, y| {
            Rgb([x as u8 * 3, y as u8 * 3, (x * y) as u8])
        });
        photo.save(&path).unwrap();
        assert!(read_upright(&path).unwrap().warnings.is_empty());
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() * 2 / 3]).unwrap();
        let error = read_rgb(&path).unwrap_err();
        assert!(
            error.with_causes().contains("cut off"),
            "{}",
            error.with_causes()
        );
    }

    #[test]
    fn ten_bits_in_sixteen_are_stretched_and_reported() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("infrared.png");
        let image =
            ImageBuffer::<image::Luma<u16>, _>::from_fn(64, 2, |x, _| image::Luma([x as u16 * 16]));
        image.save(&path).unwrap();
        let found = read_upright(&path).unwrap();
        assert_eq!(found.rgb.get_pixel(63, 0).0, [251; 3]);
        assert_eq!(found.warnings, [Warning::Stretched { low: 0, high: 1023 }]);
    }
}
