//! Colour images, and reading 16-bit depth images.

use super::tiff::check_tags;
use super::{Numbers, check_pixels, write_atomically};
use crate::error::{Error, Result};
use crate::{DepthMap, Orientation};
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{
    ColorType, DynamicImage, ImageDecoder, ImageError, ImageFormat, ImageReader, RgbImage,
};
use std::path::Path;

/// Reads a JPEG, PNG, WebP, TIFF, BMP or PNM as 8-bit RGB, turned upright as its EXIF record asks.
///
/// # Errors
/// A missing, damaged or unknown file.
pub fn read_rgb(path: &Path) -> Result<RgbImage> {
    read_upright(path).map(|(image, _)| image)
}

/// As [`read_rgb`], with how the image was turned.
///
/// # Errors
/// A missing, damaged or unknown file.
pub fn read_upright(path: &Path) -> Result<(RgbImage, Orientation)> {
    let (image, orientation) = open(path)?;
    Ok((image.into_rgb8(), orientation))
}

/// Reads a grey image of 8 or 16 bits as depth: metres = value x `scale` for such numbers, 0 = no
/// measurement. Says too which they are.
pub(crate) fn read_grey(
    path: &Path,
    scale: impl Fn(Numbers) -> f64,
) -> Result<(DepthMap, Numbers)> {
    let image = open(path)?.0;
    if image.color().has_color() {
        return Err(
            Error::format(path, "is a colour image, expected grey depths")
                .hint("depth images are grey and have 16 bits: PNG, TIFF or PGM"),
        );
    }
    let (width, height) = (image.width() as usize, image.height() as usize);
    let numbers = if image.color().bytes_per_pixel() / image.color().channel_count() == 1 {
        Numbers::Bytes
    } else {
        Numbers::Integers
    };
    let scale = scale(numbers);
    let metres = |value: u16| (f64::from(value) * scale) as f32;
    // The library would stretch 8 bits to 16.
    let values = match image {
        DynamicImage::ImageLuma8(grey) => grey.iter().map(|&v| metres(u16::from(v))).collect(),
        DynamicImage::ImageLumaA8(grey) => grey
            .pixels()
            .map(|pixel| metres(u16::from(pixel.0[0])))
            .collect(),
        other => other.into_luma16().iter().map(|&v| metres(v)).collect(),
    };
    Ok((DepthMap::new(width, height, values)?, numbers))
}

/// Reads a 16-bit (or 8-bit) grey PNG as depth: metres = value x `scale`, 0 = no measurement.
///
/// # Errors
/// A missing or damaged file, or a colour image.
pub fn read_depth_png(path: &Path, scale: f64) -> Result<DepthMap> {
    read_grey(path, |_| scale).map(|(depth, _)| depth)
}

/// Writes an 8-bit colour PNG.
///
/// # Errors
/// The file cannot be written.
pub fn write_rgb(path: &Path, image: &RgbImage) -> Result<()> {
    write_atomically(path, |out| {
        // Trying every filter on each row takes longer than what it saves is worth.
        let encoder = PngEncoder::new_with_quality(out, CompressionType::Fast, FilterType::Up);
        image.write_with_encoder(encoder).map_err(|e| match e {
            ImageError::IoError(e) => e,
            other => std::io::Error::other(other),
        })
    })
}

/// Width and height of an image as stored, from its head alone.
///
/// # Errors
/// A missing or unknown file, and one whose head is damaged.
pub fn image_size(path: &Path) -> Result<(usize, usize)> {
    image_kind(path).map(|(size, _)| size)
}

/// Width, height and what a pixel is made of, as stored.
pub(crate) fn image_kind(path: &Path) -> Result<((usize, usize), ColorType)> {
    let decoder = decoder(path)?;
    let (width, height) = decoder.dimensions();
    Ok(((width as usize, height as usize), decoder.color_type()))
}

/// Returns whether an image holds depths: one channel of 16 bits.
///
/// # Errors
/// As for [`image_size`].
pub fn is_depth_image(path: &Path) -> Result<bool> {
    image_kind(path).map(|(_, kind)| kind == ColorType::L16)
}

/// An image turned upright, and how.
fn open(path: &Path) -> Result<(DynamicImage, Orientation)> {
    let mut decoder = decoder(path)?;
    let damaged = |e: ImageError| damaged(path, e);
    let exif = decoder.orientation().map_err(damaged)?;
    let mut image = DynamicImage::from_decoder(decoder).map_err(damaged)?;
    let size = (image.width() as usize, image.height() as usize);
    image.apply_orientation(exif);
    Ok((image, Orientation::new(size, exif.to_exif())))
}

fn damaged(path: &Path, cause: ImageError) -> Error {
    Error::format(path, "is not a readable image")
        .because(cause)
        .hint("JPEG, PNG, WebP, TIFF, BMP and PNM are read; check that the file is complete")
}

fn decoder(path: &Path) -> Result<impl ImageDecoder> {
    let size = std::fs::metadata(path)
        .map_err(|e| Error::read(path, e))?
        .len();
    let reader = ImageReader::open(path)
        .and_then(ImageReader::with_guessed_format)
        .map_err(|e| Error::read(path, e))?;
    if reader.format() == Some(ImageFormat::Tiff) {
        check_tags(path)?;
    }
    let decoder = reader.into_decoder().map_err(|e| damaged(path, e))?;
    check_pixels(path, decoder.dimensions(), decoder.total_bytes(), size)?;
    Ok(decoder)
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{ImageBuffer, ImageEncoder as _, LumaA, Rgb};

    /// The EXIF record that says an orientation and nothing else: a TIFF directory of one tag.
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
            let (upright, found) = read_upright(&path).unwrap();
            assert_eq!(found, Orientation::new((5, 3), orientation));
            for (x, y, pixel) in image.enumerate_pixels() {
                let [u, v] = found.turned([f64::from(x), f64::from(y)]);
                assert_eq!(upright.get_pixel(u as u32, v as u32), pixel);
            }
        }
    }

    #[test]
    fn transparency_does_not_scale_depths_of_8_bits() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("grey.png");
        let image: ImageBuffer<LumaA<u8>, Vec<u8>> =
            ImageBuffer::from_fn(4, 3, |x, _| LumaA([10 * x as u8, 255]));
        image.save(&path).unwrap();
        let (depth, numbers) = read_grey(&path, |_| 0.01).unwrap();
        assert_eq!(numbers, Numbers::Bytes);
        assert!((depth.at(3, 2) - 0.3).abs() < 1e-6);
    }
}
