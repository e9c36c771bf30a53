//! Many images on a thread pool of the caller, each on one thread.
//!
//!     cargo run --release -p lsdc-core --example batch

#![allow(clippy::print_stdout, clippy::unwrap_used)]

#[path = "room/mod.rs"]
mod files;

use lsdc_core::{Channels, Completer, Image, Weights};
use rayon::prelude::*;
use std::error::Error;

fn main() -> Result<(), Box<dyn Error>> {
    let rgb = files::image()?;
    let (width, height) = (rgb.width() as usize, rgb.height() as usize);
    let points = files::points(width)?;
    let completer = Completer::new(&Weights::builtin_small())?;

    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build()?;
    let maps: Vec<_> = pool.install(|| {
        (0..4_usize)
            .into_par_iter()
            .map(|brighter| {
                let colours = rgb.as_raw().iter();
                let colours: Vec<u8> = colours
                    .map(|v| v.saturating_add(10 * brighter as u8))
                    .collect();
                let image = Image::new(width, height, Channels::Rgb, &colours)?;
                completer.scene(&image)?.complete(&points)?.depth()
            })
            .collect::<lsdc_core::Result<_>>()
    })?;

    let middle: Vec<f32> = maps
        .iter()
        .map(|map| map.at(width / 2, height / 2))
        .collect();
    println!("depth in the middle of {} images: {middle:?} m", maps.len());
    assert!(
        middle
            .iter()
            .all(|depth| (depth / middle[0] - 1.0).abs() < 0.1)
    );
    Ok(())
}
