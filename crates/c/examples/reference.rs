//! Writes the results that the examples in C and C++ must reproduce bit for bit: the room of the repository with `lsdc-core`.
//!
//!     cargo run --release -p lsdc-c --example reference -- FOLDER
//!
//! Writes `rgb.ppm`, and `depth.npy`, `deviation.npy` and `half.npy` (at half size) as the examples write them. For the example
//! `network_output`: `input.f32`, `basis.f32`, `affinities.f32`, and `output.npy`, the depth fitted with these.

use lsdc_core::{Channels, Completer, DepthMap, Image, NetworkOutput, Observations, Weights};
use std::error::Error;
use std::path::{Path, PathBuf};

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args_os().nth(1).ok_or("which folder?")?;
    let folder = PathBuf::from(folder);
    let room = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/room");
    let rgb = image::open(room.join("rgb.png"))?.into_rgb8();
    let (width, height) = (rgb.width() as usize, rgb.height() as usize);
    let header = format!("P6 {width} {height} 255\n").into_bytes();
    std::fs::write(
        folder.join("rgb.ppm"),
        [&header, rgb.as_raw().as_slice()].concat(),
    )?;

    let bytes = std::fs::read(room.join("sparse.npy"))?;
    let start = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let depths = bytes[start..].chunks_exact(4);
    let depths = depths.map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let points = Observations::from_map(&DepthMap::new(width, height, depths.collect())?);

    let completer = Completer::new(&Weights::builtin())?;
    let image = Image::new(width, height, Channels::Rgb, &rgb)?;
    let completion = completer.scene(&image)?.complete(&points)?;
    write(&folder.join("depth.npy"), &completion.depth()?)?;
    write(
        &folder.join("deviation.npy"),
        &completion.standard_deviation()?,
    )?;
    let half = completion.depth_at(width / 2, height / 2)?;
    write(&folder.join("half.npy"), &half)?;
    other_network(&folder, &image, &points)
}

/// Writes the files of `network_output`, with a constant, waves and striped affinities instead of another program's output.
fn other_network(
    folder: &Path,
    image: &Image<'_>,
    points: &Observations,
) -> Result<(), Box<dyn Error>> {
    let completer = Completer::new(&Weights::builtin_small())?;
    let input = completer.network_input(image)?;
    let pixels = input.width * input.height;
    let wave = |i: usize| match i / pixels {
        0 => 1.0,
        k => (0.003 * (k * (i % pixels)) as f32).sin(),
    };
    let basis: Vec<f32> = (0..65 * pixels).map(wave).collect();
    let affinities: Vec<f32> = (0..2 * pixels).map(|i| 1.0 + (i % 3) as f32).collect();
    for (name, values) in [
        ("input", &input.values),
        ("basis", &basis),
        ("affinities", &affinities),
    ] {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_ne_bytes()).collect();
        std::fs::write(folder.join(name).with_extension("f32"), bytes)?;
    }
    let output = NetworkOutput::new(input.width, input.height, basis, affinities)?;
    let completion = completer
        .scene_with_output(image, &output)?
        .complete(points)?;
    write(&folder.join("output.npy"), &completion.depth()?)?;
    Ok(())
}

fn write(path: &Path, map: &DepthMap) -> std::io::Result<()> {
    let shape = format!("({}, {})", map.height(), map.width());
    let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}");
    let mut bytes = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
    bytes.extend(format!("{header:117}\n").into_bytes());
    bytes.extend(map.values().iter().flat_map(|value| value.to_le_bytes()));
    std::fs::write(path, bytes)
}
