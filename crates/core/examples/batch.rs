//! Completes many images on a thread pool of the caller, each image on one thread.
//!
//!     cargo run --release -p lsdc-core --example batch [IMAGES]

#![allow(clippy::print_stdout, clippy::unwrap_used)]

#[path = "room/mod.rs"]
mod files;

use lsdc_core::{Channels, Completer, Image, Weights};
use rayon::prelude::*;
use std::error::Error;
use std::time::Instant;

fn main() -> Result<(), Box<dyn Error>> {
    let rgb = files::image()?;
    let (width, height) = (rgb.width() as usize, rgb.height() as usize);
    let points = files::points(width)?;
    let completer = Completer::new(&Weights::builtin_small())?;

    let count: usize = std::env::args()
        .nth(1)
        .map_or(Ok(4), |count| count.parse())?;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build()?;
    let started = Instant::now();
    let maps: Vec<_> = pool.install(|| {
        (0..count)
            .into_par_iter()
            .map(|i| {
                let brighter = (10 * (i % 4)) as u8;
                let colours = rgb.as_raw().iter();
                let colours: Vec<u8> = colours.map(|v| v.saturating_add(brighter)).collect();
                let image = Image::new(width, height, Channels::Rgb, &colours)?;
                completer.scene(&image)?.complete(&points)?.depth()
            })
            .collect::<lsdc_core::Result<_>>()
    })?;

    let seconds = started.elapsed().as_secs_f64();
    println!("{:.1} images a second", count as f64 / seconds);

    let middle: Vec<f32> = maps
        .iter()
        .map(|map| map.at(width / 2, height / 2))
        .collect();
    let (first, all) = (middle[0], middle.len());
    println!("depth in the middle of the first of {all} images: {first:.2} m");
    assert!(middle.iter().all(|depth| (depth / first - 1.0).abs() < 0.1));
    Ok(())
}
