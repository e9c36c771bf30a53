//! An image and its points to depth, in three lines.
//!
//!     cargo run --release --example complete -- assets/room/rgb.png assets/room/sparse.npy depth.npy

use lsdc::data::{Sparse, read_rgb, write_npy};
use lsdc::error::{Error, Result};
use lsdc::predict::Completer;
use std::path::Path;

fn main() -> Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [image, points, output] = &args[..] else {
        return Err(Error::config(
            "expected an image, its points, and a file to write",
        ));
    };
    let image = read_rgb(Path::new(image))?;
    let size = (image.width() as usize, image.height() as usize);
    let points = Sparse::read(Path::new(points), None, None, size)?.map()?;

    let completion = Completer::load()?.complete(&image, &points)?;

    write_npy(Path::new(output), &completion.depth)
}
