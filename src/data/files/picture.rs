//! Colour images, and reading 16-bit depth images.

use super::tiff::check_tags;
use super::{plausible, write_atomically};
use crate::data::DepthMap;
use crate::error::{Error, Result};
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{
    ColorType, DynamicImage, ImageDecoder, ImageError, ImageFormat, ImageReader, RgbImage,
};
use std::path::Path;

/// Reads a JPEG, PNG, WebP or TIFF as 8-bit RGB, turned upright as its EXIF record asks.
///
/// # Errors
/// A missing, damaged or unknown file.
pub fn read_rgb(path: &Path) -> Result<RgbImage> {
    Ok(open(path)?.into_rgb8())
}

/// Reads a 16-bit (or 8-bit) grey PNG as depth: metres = value x `scale`, 0 = no measurement.
///
/// # Errors
/// A missing or damaged file, or a colour image.
pub fn read_depth_png(path: &Path, scale: f64) -> Result<DepthMap> {
    let image = open(path)?;
    if image.color().has_color() {
        return Err(
            Error::format(path, "is a colour image, expected grey depths")
                .hint("depth images are 16-bit grey PNG"),
        );
    }
    let (width, height) = (image.width() as usize, image.height() as usize);
    let metres = |value: u16| (f64::from(value) * scale) as f32;
    let values = match image {
        DynamicImage::ImageLuma8(grey) => grey.iter().map(|&v| metres(u16::from(v))).collect(),
        other => other.into_luma16().iter().map(|&v| metres(v)).collect(),
    };
    DepthMap::new(width, height, values)
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

/// Width, height and what a pixel is made of, as stored.
pub(crate) fn image_kind(path: &Path) -> Result<((usize, usize), ColorType)> {
    let decoder = decoder(path)?;
    let (width, height) = decoder.dimensions();
    Ok(((width as usize, height as usize), decoder.color_type()))
}

fn open(path: &Path) -> Result<DynamicImage> {
    let mut decoder = decoder(path)?;
    let damaged = |e: ImageError| damaged(path, e);
    let orientation = decoder.orientation().map_err(damaged)?;
    let mut image = DynamicImage::from_decoder(decoder).map_err(damaged)?;
    image.apply_orientation(orientation);
    Ok(image)
}

fn damaged(path: &Path, cause: ImageError) -> Error {
    Error::format(path, "is not a readable image")
        .because(cause)
        .hint("JPEG, PNG, WebP and TIFF are read; check that the file is complete")
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
    let (width, height) = decoder.dimensions();
    if !plausible(decoder.total_bytes(), size) {
        return Err(Error::format(
            path,
            format!("declares {width}x{height} pixels but is only {size} bytes long"),
        )
        .hint("the file is damaged; write it again"));
    }
    Ok(decoder)
}
