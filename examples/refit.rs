//! A still camera and points that come in one after the other: the network runs once, each new set
//! of points costs a fit, and each pixel says how sure it is.
//!
//!     cargo run --release --example refit -- assets/room/rgb.png assets/room/sparse.npy

#![allow(clippy::print_stdout)]

use lsdc::data::{DepthMap, Sparse, read_rgb};
use lsdc::error::{Error, Result};
use lsdc::predict::Completer;
use std::path::Path;

fn main() -> Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [image, points] = &args[..] else {
        return Err(Error::config("expected an image and its points"));
    };
    let image = read_rgb(Path::new(image))?;
    let (width, height) = (image.width() as usize, image.height() as usize);
    let points = Sparse::read(Path::new(points), None, None, (width, height))?.map()?;
    let points: Vec<_> = points.points().collect();

    let completer = Completer::load()?;
    let bases = completer.bases(&image)?;
    let mut seen = 1;
    while seen <= points.len() {
        let sparse = DepthMap::from_points(width, height, &points[..seen]);
        let fit = completer.fit(&bases, &sparse, None)?;
        let depth = completer.dense(&bases, &fit, &sparse, None)?;
        let sigma = completer.deviation(&bases, &sparse, &fit, &depth)?;
        let mean = sigma.values().iter().sum::<f32>() / sigma.values().len() as f32;
        println!("{seen:>4} points: {mean:.3} m of standard deviation, on average");
        seen *= 4;
    }
    Ok(())
}
