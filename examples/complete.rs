//! Completes depth from an image file and a file of points, in any format that `lsdc complete` reads.
//!
//!     cargo run --release --example complete -- assets/room/rgb.png assets/room/sparse.npy depth.npy

use lsdc_core::{Completer, Weights};
use lsdc_eval::data::{Sparse, read_rgb, write_npy};
use lsdc_eval::predict::scene;
use lsdc_files::error::{Error, Result};
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
    let points = Sparse::read(Path::new(points), None, None, size)?.points;

    let completer = Completer::new(&Weights::builtin())?;
    let completion = scene(&completer, &image)?.complete(&points)?;

    write_npy(Path::new(output), &completion.depth()?)
}
