//! Calibration and training on a user's frames: laser scans, and a depth camera.

#![allow(clippy::unwrap_used)]

mod scans;

use assert_cmd::Command;
use image::{Rgb, RgbImage};
use lsdc_core::Weights;
use lsdc_core::fit::Lambda;
use lsdc_eval::data::{DepthMap, write_depth_png};
use lsdc_weights::{history, open_weights};
use serde_json::{Value, json};
use std::path::Path;

/// Configuration of a network that trains on rooms in seconds.
const SMALL: &str = r#"
preset = "small"

[network]
octaves = 3
affinities = 8
hidden = [32]
bases = 24
extractor = { stem = 8, stages = [
    { width = 8, blocks = 1 }, { width = 16, blocks = 1 },
    { width = 16, blocks = 1 }, { width = 16, blocks = 1 },
], branch = 8, merge = 16, features = 16 }

[fit]
method = "joint"

[data.rooms]
train = 12
width = 64
height = 48

[train]
steps = 2
batch = 2
learning_rate = 1e-3
held_out = 2
protocol = {}
supervision = { points = 200, fewest = 100, patches = 4, patch = 8 }
"#;

/// Runs the program, which must succeed, and returns its output.
fn said(folder: &Path, args: &[&str]) -> String {
    let run = Command::new(env!("CARGO_BIN_EXE_lsdc"))
        .current_dir(folder)
        .env_remove("LSDC_DATA")
        .args(args)
        .output()
        .unwrap();
    let text = String::from_utf8(run.stderr).unwrap();
    assert!(run.status.success(), "{args:?}: {text}");
    text
}

/// A folder with trained weights of a small network.
fn trained() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("small.toml"), SMALL).unwrap();
    said(
        folder.path(),
        &["train", "--config", "small.toml", "-o", "small"],
    );
    folder
}

/// Writes six scans of 12 rings: a road seen from 1.6 m above it, a wall 6 m ahead, and three returns beyond the wall. Ground
/// truth covers 4 % of the pixels; the last image is smaller.
fn write_scans(folder: &Path) {
    for number in 0..6_u8 {
        let (width, height) = if number == 5 { (244, 74) } else { (248, 76) };
        let image = RgbImage::from_fn(width, height, |x, y| {
            let wall = if y < 56 { 90 } else { 20 };
            Rgb([wall + 20 * number, (x / 2) as u8, (3 * y) as u8])
        });
        let ring = |ring: i16| {
            let v = 26.0 + 4.0 * f32::from(ring);
            let depth = (1.6 * 120.0 / (v - 24.0)).min(6.0);
            (0..60_u8).map(move |i| (4.0 * f32::from(i) + 1.0, v, depth, ring))
        };
        let hidden = (0..3_u8).map(|i| (100.0 + 8.0 * f32::from(i), 35.0, 20.0, -1));
        let returns: Vec<scans::Return> = (0..12).flat_map(ring).chain(hidden).collect();
        scans::write_scan(folder, &number.to_string(), &image, &returns);
    }
}

fn weights(path: &Path) -> Weights {
    open_weights(Some(path)).unwrap()
}

/// Settings of the last command in the history of weights.
fn last_settings(weights: &Weights) -> Value {
    let entries = history::read(&weights.notes).unwrap();
    entries.last().unwrap().settings.clone()
}

/// Whether numbers agree to f16 precision.
fn close(a: &[f32], b: &[f32]) -> bool {
    let pairs = a.iter().zip(b);
    a.len() == b.len()
        && pairs
            .clone()
            .all(|(a, b)| (a - b).abs() <= 1e-3 * a.abs() + 1e-6)
}

#[test]
fn a_few_scans_calibrate_weights_and_leave_their_prior() {
    let folder = trained();
    let at = folder.path();
    write_scans(&at.join("scans"));
    let own = ["calibrate", "--dataset", "scans", "--root", "scans"];
    let from = [
        "--weights",
        "small/weights.safetensors",
        "-o",
        "mine.safetensors",
    ];
    let text = said(at, &[&own[..], &from].concat());
    for words in [
        "prior of the weights stays: 6 frames",
        "of 24 basis functions",
        "resized to about 3072 pixels",
        "returns beyond 1.1 x the nearest",
    ] {
        assert!(text.contains(words), "`{words}` is missing in: {text}");
    }
    let before = weights(&at.join("small/weights.safetensors"));
    let after = weights(&at.join("mine.safetensors"));
    let [(old, _), (new, calibration)] =
        [&before, &after].map(|weights| weights.prior().unwrap().unwrap());
    assert_eq!(old.numbers(), new.numbers());
    assert_eq!(old.pooled(), new.pooled());
    assert_ne!(old.noise(), new.noise());
    assert!(calibration.errors.is_some());
    assert!(before.tensors == after.tensors);
    assert!(matches!(
        after.fit().unwrap().unwrap().lambda,
        Lambda::ByCount(_)
    ));
    let settings = last_settings(&after);
    assert_eq!(settings["held_out"], 0);
    assert_eq!(settings["protocol"]["pixels"], 3072);
    assert_eq!(settings["protocol"]["resize"], Value::Null);
}

#[test]
fn a_configuration_names_the_files_of_a_depth_camera() {
    let folder = trained();
    let at = folder.path();
    std::fs::create_dir(at.join("camera")).unwrap();
    // A slope with holes at a quarter of the pixels.
    let depths = (0..160 * 90).map(|i| match i / 3 % 4 {
        0 => 0.0,
        _ => 1.0 + (i % 160) as f32 / 80.0,
    });
    let depths = DepthMap::new(160, 90, depths.collect()).unwrap();
    for number in 0..4_u8 {
        let image = RgbImage::from_fn(160, 90, |x, y| Rgb([x as u8, y as u8, 60 * number]));
        let file = |kind: &str| at.join(format!("camera/{kind}_{number}.png"));
        image.save(file("colour")).unwrap();
        write_depth_png(&file("depth"), &depths, 0.001).unwrap();
    }
    let config = "[data]\ndataset = \"folder\"\nroot = \"camera\"\n\
                  folder = { rgb = \"colour_{frame}.png\", depth = \"depth_{frame}.png\" }\n";
    std::fs::write(at.join("camera.toml"), config).unwrap();
    let own = ["calibrate", "--config", "camera.toml"];
    let from = [
        "--weights",
        "small/weights.safetensors",
        "-o",
        "mine.safetensors",
    ];
    said(at, &[&own[..], &from].concat());
    let after = weights(&at.join("mine.safetensors"));
    let entries = history::read(&after.notes).unwrap();
    assert_eq!(entries.last().unwrap().data["frames"], 4);
    let protocol = &last_settings(&after)["protocol"];
    assert_eq!(protocol["occlusion"], Value::Null);
    assert_eq!(protocol["depth_resize"], "nearest-measured");
}

#[test]
fn the_default_weights_are_trained_further_on_scans() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    write_scans(&at.join("scans"));
    let run = [
        "train", "--config", "own.toml", "--root", "scans", "-o", "run",
    ];
    let short = [
        "--set",
        "train.steps=2",
        "--set",
        "train.batch=2",
        "--set",
        "train.protocol.pixels=6000",
    ];
    said(at, &[&run[..], &short].concat());
    let (before, after) = (
        Weights::builtin(),
        weights(&at.join("run/weights.safetensors")),
    );
    // All images are resized like the first: its sides times sqrt(6000 / (248 x 76)) = 0.564.
    assert_eq!(after.normalisation.input, [43, 140]);
    assert!(before.tensors.keys().eq(after.tensors.keys()));
    let mut changed = 0;
    for (name, tensor) in &before.tensors {
        let same = close(tensor.values(), after.tensors[name].values());
        assert!(same || !name.starts_with("edges."), "{name}");
        changed += usize::from(!same);
    }
    assert!(changed > 20, "{changed}");
    let [(old, _), (new, calibration)] =
        [&before, &after].map(|weights| weights.prior().unwrap().unwrap());
    assert!(close(&old.numbers().0, &new.numbers().0));
    assert!(close(&old.numbers().1, &new.numbers().1));
    assert!(calibration.errors.is_some());

    // Calibrating again uses the held-out frames.
    let again = ["calibrate", "--dataset", "scans", "--root", "scans"];
    let from = [
        "--weights",
        "run/weights.safetensors",
        "-o",
        "again.safetensors",
    ];
    let text = said(at, &[&again[..], &from].concat());
    assert!(!text.contains("about 69312 pixels"), "{text}");
    let settings = last_settings(&weights(&at.join("again.safetensors")));
    assert_eq!(settings["held_out"], 8);
    let size = json!({ "height": 43, "width": 140 });
    assert_eq!(settings["protocol"]["resize"], size);
}
