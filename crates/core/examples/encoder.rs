//! Times a pretrained encoder alone, for `scripts/peers/run.py encoder`.
//!
//!     encoder WEIGHTS.safetensors IMAGE HEIGHT WIDTH RUNS FEATURES
//!
//! Weights are f32, named as in `DINOv2`. IMAGE and FEATURES are plain little-endian `f32`: a normalised image
//! `[height, width, 3]`, and the features of the encoder, `[taps, patches, channels]`. Prints the mean run time of RUNS runs in
//! milliseconds, after one warm-up run.

#![allow(clippy::print_stdout)]

use lsdc_core::network::{Encoder, EncoderConfig};
use lsdc_core::weights::Tensor;
use lsdc_kernels::simd::Level;
use safetensors::SafeTensors;
use std::collections::BTreeMap;
use std::error::Error;
use std::fs;
use std::time::Instant;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [weights, image, height, width, runs, features] = &arguments[..] else {
        return Err("expected WEIGHTS IMAGE HEIGHT WIDTH RUNS FEATURES".into());
    };
    let file = fs::read(weights)?;
    let mut tensors = BTreeMap::new();
    for (name, view) in SafeTensors::deserialize(&file)?.iter() {
        let tensor = Tensor::new(view.shape().to_vec(), floats(view.data()));
        tensors.insert(name.to_owned(), tensor.ok_or("weights that are not f32")?);
    }
    let encoder = Encoder::new(EncoderConfig::small(), &tensors, Level::here())?;
    let image = floats(&fs::read(image)?);
    let size = (height.parse()?, width.parse()?);
    let found = encoder.features(&image, size)?;
    let values = found.taps.iter().flatten().flat_map(|v| v.to_le_bytes());
    fs::write(features, values.collect::<Vec<u8>>())?;
    let runs: u32 = runs.parse()?;
    let started = Instant::now();
    for _ in 0..runs {
        std::hint::black_box(encoder.features(&image, size)?);
    }
    println!(
        "{}",
        started.elapsed().as_secs_f64() * 1e3 / f64::from(runs.max(1))
    );
    Ok(())
}

fn floats(bytes: &[u8]) -> Vec<f32> {
    let (values, _) = bytes.as_chunks::<4>();
    values.iter().map(|v| f32::from_le_bytes(*v)).collect()
}
