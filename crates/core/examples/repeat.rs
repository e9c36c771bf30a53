//! Completes the room COUNT times on one thread, starting from the image; `scripts/instructions.py` counts its instructions.
//!
//!     cargo run --release -p lsdc-core --example repeat -- COUNT

#![allow(clippy::print_stdout)]

#[path = "room/mod.rs"]
mod files;

use lsdc_core::{Channels, Completer, Image, Weights};
use std::error::Error;

fn main() -> Result<(), Box<dyn Error>> {
    let count = std::env::args().nth(1).ok_or("how often?")?.parse()?;
    let rgb = files::image()?;
    let (width, height) = (rgb.width() as usize, rgb.height() as usize);
    let points = files::points(width)?;
    let completer = Completer::builder(&Weights::builtin()).threads(1).build()?;
    for _ in 0..count {
        let image = Image::new(width, height, Channels::Rgb, rgb.as_raw())?;
        let depth = completer.scene(&image)?.complete(&points)?.depth()?;
        println!("{:.4} m in the middle", depth.at(width / 2, height / 2));
    }
    Ok(())
}
