//! Writes what Depth Anything V2 Small, as installed, predicts for an image: relative inverse depth.
//!
//!     inverse_depth IMAGE OUTPUT.npy [SIDE]
//!
//! Prints the milliseconds of a second prediction.

#![allow(clippy::print_stdout)]

use lsdc_core::{Channels, DepthAnything, DepthMap, Image};
use lsdc_files::{read_rgb, write_npy};
use lsdc_weights::{ResizeLayer, depth_anything};
use std::error::Error;
use std::path::Path;
use std::time::Instant;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (image, output, side) = match &arguments[..] {
        [image, output] => (image, output, DepthAnything::SHORT_SIDE),
        [image, output, side] => (image, output, side.parse()?),
        _ => return Err("expected IMAGE OUTPUT.npy [SIDE]".into()),
    };
    let rgb = read_rgb(Path::new(image))?;
    let (width, height) = (rgb.width() as usize, rgb.height() as usize);
    let image = Image::new(width, height, Channels::Rgb, rgb.as_raw())?;
    let network = depth_anything(ResizeLayer::default())?.network;
    let (values, (height, width)) = network.inverse_depth(&image, side)?;
    write_npy(Path::new(output), &DepthMap::new(width, height, values)?)?;
    let started = Instant::now();
    std::hint::black_box(network.inverse_depth(&image, side)?);
    println!("{}", started.elapsed().as_secs_f64() * 1e3);
    Ok(())
}
