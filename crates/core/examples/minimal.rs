//! A program for small machines: the weights `small` alone, one image, no other library.
//!
//!     cargo build --profile minimal -p lsdc-core --no-default-features --features weights-small --example minimal
//!     minimal IMAGE.ppm POINTS.csv DEPTH.npy
//!
//! Points are lines of `u,v,depth`: columns and rows in pixels, metres. `scripts/small.py` checks its size and memory.

#![allow(clippy::print_stdout)]

use lsdc_core::{Channels, Completer, DepthMap, Image, Observations, Weights};
use std::error::Error;
use std::path::Path;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [image, points, depth] = &arguments[..] else {
        return Err("usage: minimal IMAGE.ppm POINTS.csv DEPTH.npy".into());
    };
    let (width, height, rgb) = read_ppm(Path::new(image))?;
    let points = read_points(Path::new(points))?;
    let completer = Completer::new(&Weights::builtin_small())?;
    let scene = completer.scene(&Image::new(width, height, Channels::Rgb, &rgb)?)?;
    // No other image follows: the fit can reuse the memory of the network.
    drop(rgb);
    completer.release();
    let completion = scene.complete(&points)?;
    write_npy(Path::new(depth), &completion.depth()?)?;
    let report = completion.report();
    println!("{} of {} points", report.used, report.given);
    Ok(())
}

/// The width and height of an 8-bit PPM (P6) without comments, and its colours.
fn read_ppm(path: &Path) -> Result<(usize, usize, Vec<u8>), Box<dyn Error>> {
    let mut bytes = std::fs::read(path)?;
    let mut words = Vec::new();
    let mut start = 0;
    while words.len() < 4 {
        let rest = bytes.get(start..).unwrap_or_default();
        let length = rest.iter().position(u8::is_ascii_whitespace);
        let length = length.ok_or_else(|| format!("`{}` is no PPM", path.display()))?;
        words.push(std::str::from_utf8(&rest[..length])?.to_owned());
        start += length + 1;
    }
    if words[0] != "P6" || words[3] != "255" {
        return Err(format!("`{}` is no PPM of 8 bits", path.display()).into());
    }
    bytes.drain(..start);
    Ok((words[1].parse()?, words[2].parse()?, bytes))
}

fn read_points(path: &Path) -> Result<Observations, Box<dyn Error>> {
    let mut points = Observations::new();
    for (i, line) in std::fs::read_to_string(path)?.lines().enumerate() {
        let numbers = line.split(',').map(|word| word.trim().parse::<f64>());
        let numbers: Vec<f64> = numbers
            .collect::<Result<_, _>>()
            .map_err(|error| format!("`{}`, line {}: {error}", path.display(), i + 1))?;
        let &[u, v, depth] = &numbers[..] else {
            return Err(format!("`{}`, line {}: not u,v,depth", path.display(), i + 1).into());
        };
        points.add(u, v, depth as f32);
    }
    Ok(points)
}

fn write_npy(path: &Path, map: &DepthMap) -> std::io::Result<()> {
    let shape = format!("({}, {})", map.height(), map.width());
    let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}");
    let mut bytes = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
    bytes.extend(format!("{header:117}\n").into_bytes());
    bytes.extend(map.values().iter().flat_map(|value| value.to_le_bytes()));
    std::fs::write(path, bytes)
}
