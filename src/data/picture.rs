//! Colour images and 16-bit depth images.

use super::{DepthMap, write_atomically};
use crate::error::{Cause, Error, Result};
use image::{
    DynamicImage, ImageBuffer, ImageDecoder as _, ImageFormat, ImageReader, Luma, RgbImage,
};
use std::io::Cursor;
use std::path::Path;

/// Reads a JPEG or PNG as 8-bit RGB, turned upright as its EXIF record asks.
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
pub fn read_depth_png(path: &Path, scale: f32) -> Result<DepthMap> {
    let image = open(path)?;
    if image.color().has_color() {
        return Err(
            Error::format(path, "is a colour image, expected grey depths")
                .hint("depth images are 16-bit grey PNG"),
        );
    }
    let (width, height) = (image.width() as usize, image.height() as usize);
    let values = match image {
        DynamicImage::ImageLuma8(grey) => grey.iter().map(|&v| f32::from(v) * scale).collect(),
        other => other
            .into_luma16()
            .iter()
            .map(|&v| f32::from(v) * scale)
            .collect(),
    };
    DepthMap::new(width, height, values)
}

/// Writes depths as a 16-bit grey PNG, value = metres / `scale` rounded; what does not fit is 0.
///
/// # Errors
/// The file cannot be written.
pub fn write_depth_png(path: &Path, depth: &DepthMap, scale: f32) -> Result<()> {
    let values = depth
        .values()
        .iter()
        .map(|v| (v / scale).round())
        .map(|v| {
            if v <= f32::from(u16::MAX) {
                v as u16
            } else {
                0
            }
        })
        .collect();
    let image: ImageBuffer<Luma<u16>, Vec<u16>> =
        ImageBuffer::from_raw(depth.width() as u32, depth.height() as u32, values)
            .ok_or_else(|| Error::shape("depth map and image differ in size"))?;
    write_png(path, &image.into())
}

/// Writes an 8-bit colour PNG.
///
/// # Errors
/// The file cannot be written.
pub fn write_rgb(path: &Path, image: &RgbImage) -> Result<()> {
    write_png(path, &image.clone().into())
}

fn write_png(path: &Path, image: &DynamicImage) -> Result<()> {
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, ImageFormat::Png).map_err(|e| {
        Error::new(Cause::Write, format!("cannot encode `{}`", path.display())).because(e)
    })?;
    write_atomically(path, |out| out.write_all(bytes.get_ref()))
}

fn open(path: &Path) -> Result<DynamicImage> {
    let damaged = |e: image::ImageError| {
        Error::format(path, "is not a readable image")
            .because(e)
            .hint("JPEG and PNG are read; check that the file is complete")
    };
    let mut decoder = ImageReader::open(path)
        .and_then(ImageReader::with_guessed_format)
        .map_err(|e| Error::read(path, e))?
        .into_decoder()
        .map_err(damaged)?;
    let orientation = decoder.orientation().map_err(damaged)?;
    let mut image = DynamicImage::from_decoder(decoder).map_err(damaged)?;
    image.apply_orientation(orientation);
    Ok(image)
}
