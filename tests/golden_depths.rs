//! Regression test of numerics: results for rooms, on coarse grids, match `crates/weights/golden` with every instruction set.
//! So do predictions of a tiny Depth Anything.
//!
//! A change of numerics fails this test until the file is updated on purpose:
//!
//!     LSDC_UPDATE_GOLDEN=1 cargo test --release --test golden_depths
//!
//! which replaces only values that differ. The file identifies the numerics of the program (`provenance::numerics`), so the
//! program does not reuse results on disk from before the update.

#![allow(clippy::print_stdout, clippy::unwrap_used)]

mod depth_anything;
mod golden_rooms;

use golden_rooms::{Result, Results, TOLERANCE, difference, grid, inputs, of_rooms, read};
use lsdc::config::Config;
use lsdc_core::cloud::{Viewpoint, visible};
use lsdc_core::fit::FitConfig;
use lsdc_core::network::{DepthHead, Encoder, EncoderConfig};
use lsdc_core::weights::Tensor;
use lsdc_core::{Channels, DepthAnything, Image, Observation};
use lsdc_eval::data::{DepthMap, Frame, Split};
use lsdc_kernels::simd::Level;
use lsdc_train::device::Device;
use lsdc_train::predict::completer;
use lsdc_train::training::{Trainer, TrainingEvent};
use lsdc_weights::open_weights;
use lsdc_weights::provenance;
use safetensors::{Dtype, tensor::TensorView};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::Command;
use std::sync::atomic::AtomicBool;

/// Tolerance of training losses, relative to the first. Rounding errors accumulate over the steps: differences of up to 2.4e-5
/// were measured.
const TOLERANCE_TRAINED: f32 = 5e-5;

fn compute() -> Results {
    let inputs = inputs();
    let mut results = of_rooms(&inputs, |name| {
        let weights = open_weights(Some(name.as_ref())).unwrap();
        completer(&weights, &Device::flex()).unwrap()
    });
    let name = "depth-anything/inverse depth".to_owned();
    results.insert(name, inverse_depth(&inputs[2].frame));
    results.insert("cloud/visible".into(), visible_returns());
    let values = trained();
    let losses = Result {
        scale: values[0],
        values,
        tolerance: TOLERANCE_TRAINED,
    };
    results.insert("training/losses".into(), losses);
    results
}

/// Inverse depths, from which guides are made, by encoder and depth head with random weights; the published weights are not in
/// the program.
fn inverse_depth(frame: &Frame) -> Result {
    let (width, height) = (frame.rgb.width() as usize, frame.rgb.height() as usize);
    let image = Image::new(width, height, Channels::Rgb, frame.rgb.as_raw()).unwrap();
    let network = depth_anything::network();
    let (values, (height, width)) = network
        .inverse_depth(&image, DepthAnything::SHORT_SIDE)
        .unwrap();
    let largest = values.iter().fold(0.0, |most: f32, v| most.max(*v));
    assert!(largest > 0.0);
    Result {
        values: grid(&DepthMap::new(width, height, values).unwrap()),
        scale: largest,
        tolerance: TOLERANCE,
    }
}

/// Which returns of a scan are visible (1): an object at 8 m hides some of a wall at 30 m.
fn visible_returns() -> Result {
    let mut points = Vec::new();
    let mut add = |u: i32, v: i32, depth| {
        points.push(Observation {
            u: u.into(),
            v: v.into(),
            depth,
            sigma: None,
        });
    };
    for v in (0..200).step_by(5) {
        for u in (0..600).step_by(4) {
            let is_object = (200..300).contains(&u) && (50..150).contains(&v);
            add(u, v, if is_object { 8.0 } else { 30.0 });
            if is_object && u < 213 {
                add(u + 1, v + 2, 30.0);
            }
        }
    }
    let visible = visible(&points, (600, 200), Viewpoint::Unknown);
    assert!(visible.contains(&false));
    Result {
        values: visible.iter().map(|visible| f32::from(*visible)).collect(),
        scale: 1.0,
        tolerance: TOLERANCE,
    }
}

/// Losses of the first training steps, which depend on the gradients.
fn trained() -> Vec<f32> {
    let folder = tempfile::tempdir().unwrap();
    let settings = [
        "data.rooms.width=64",
        "data.rooms.height=48",
        "data.rooms.train=8",
        "train.steps=4",
        "train.optimiser=sgd",
        "train.held_out=0",
        "train.calibrate=false",
    ];
    let settings = settings.map(String::from);
    let config = Config::load(Some("smoke.toml".as_ref()), &settings).unwrap();
    let frames = config.data.open(Split::Train, None).unwrap();
    let fit = config.fit.over(&FitConfig::default()).unwrap();
    let devices = [Device::flex()];
    let (network, train) = (config.network(), config.train);
    let trainer = Trainer::new(folder.path(), network, fit, train, frames, &devices).unwrap();
    let mut losses = Vec::new();
    let mut hear = |event: &TrainingEvent| {
        if let TrainingEvent::Step { loss, .. } = event {
            losses.push(*loss as f32);
        }
    };
    trainer.run(&AtomicBool::new(false), &mut hear).unwrap();
    losses
}

fn file() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("crates/weights/golden/depths.safetensors")
}

fn write(golden: &BTreeMap<String, Vec<f32>>) {
    let bytes: BTreeMap<&String, Vec<u8>> = golden
        .iter()
        .map(|(name, values)| (name, values.iter().flat_map(|v| v.to_le_bytes()).collect()))
        .collect();
    let views = bytes.iter().map(|(name, bytes)| {
        (
            *name,
            TensorView::new(Dtype::F32, vec![bytes.len() / 4], bytes).unwrap(),
        )
    });
    std::fs::write(file(), safetensors::serialize(views, None).unwrap()).unwrap();
}

fn updates() -> bool {
    std::env::var_os("LSDC_UPDATE_GOLDEN").is_some()
}

#[test]
fn depths_are_the_golden_ones() {
    let found = compute();
    let mut golden = read(&std::fs::read(file()).unwrap());
    if updates() {
        golden.retain(|name, _| found.contains_key(name));
        for (name, found) in &found {
            if difference(golden.get(name), found) > 1.0 {
                golden.insert(name.clone(), found.values.clone());
            }
        }
        write(&golden);
    }
    let differences: Vec<(f32, &String)> = found
        .iter()
        .map(|(name, found)| (difference(golden.get(name), found), name))
        .collect();
    let largest = differences
        .iter()
        .fold(0.0, |most: f32, (apart, _)| most.max(*apart));
    println!(
        "{}: {} results, largest difference {largest:.3} of the tolerance",
        Level::here().name(),
        found.len()
    );
    let wrong: Vec<_> = differences
        .iter()
        .filter(|(apart, _)| *apart > 1.0)
        .collect();
    assert!(
        wrong.is_empty() && golden.len() == found.len(),
        "{} of {} results at {} are not the golden ones, apart by so many tolerances: {wrong:?}\n\
         If that is meant: LSDC_UPDATE_GOLDEN=1 cargo test --release --test golden_depths",
        wrong.len(),
        golden.len(),
        Level::here().name(),
    );
}

#[test]
fn depths_are_the_golden_ones_at_every_other_level() {
    if updates() {
        return;
    }
    let others = Level::ALL
        .into_iter()
        .filter(|level| level.is_available() && *level != Level::here());
    for level in others {
        let run = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "depths_are_the_golden_ones", "--nocapture"])
            .env("LSDC_SIMD", level.name())
            .output()
            .unwrap();
        let text = String::from_utf8_lossy(&run.stdout) + String::from_utf8_lossy(&run.stderr);
        print!("{text}");
        assert!(run.status.success(), "{text}");
        assert!(text.contains(&format!("{}: ", level.name())));
    }
}

#[test]
fn the_golden_file_identifies_the_numerics() {
    let bytes = std::fs::read(file()).unwrap();
    assert!(bytes.len() < 300_000, "{}", bytes.len());
    let numerics = provenance::numerics();
    assert_eq!(numerics["golden"], lsdc_weights::golden());
    assert_eq!(numerics["simd"], Level::here().name());
}
