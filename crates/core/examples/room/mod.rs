//! The rendered room of the repository: an image and sparse depths.

#![allow(dead_code)]

use image::RgbImage;
use lsdc_core::Observations;
use std::error::Error;
use std::path::PathBuf;

fn asset(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join("../../assets/room")
        .join(name)
}

/// The image.
pub(crate) fn image() -> Result<RgbImage, Box<dyn Error>> {
    Ok(image::open(asset("rgb.png"))?.into_rgb8())
}

/// Column, row and depth.
type Pixel = (f64, f64, f32);

/// A map of NumPy's format with float32 depths, 0 where there is none.
pub(crate) fn map(name: &str, width: usize) -> Result<Vec<Pixel>, Box<dyn Error>> {
    let bytes = std::fs::read(asset(name))?;
    let header = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let depths = bytes[header..].chunks_exact(4);
    let depths = depths.map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let place = |(i, depth): (usize, f32)| ((i % width) as f64, (i / width) as f64, depth);
    Ok(depths
        .enumerate()
        .map(place)
        .filter(|point| point.2 > 0.0)
        .collect())
}

/// The sparse depths.
pub(crate) fn points(width: usize) -> Result<Observations, Box<dyn Error>> {
    let mut points = Observations::new();
    for (u, v, depth) in map("sparse.npy", width)? {
        points.add(u, v, depth);
    }
    Ok(points)
}
