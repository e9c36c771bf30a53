//! `lsdc complete` on a GPU or a software driver.

#![allow(clippy::unwrap_used, clippy::print_stderr)]

use assert_cmd::Command;
use image::imageops::{flip_horizontal, flip_vertical, rotate180};
use lsdc_eval::data::{DepthMap, read_npy};
use lsdc_gpu::{Adapter, Gpu};
use std::path::Path;

const NAMES: [&str; 4] = ["a", "b", "c", "d"];

/// A folder with different images `a` to `d`, and points.
fn folders() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let room = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/room");
    let image = image::open(room.join("rgb.png")).unwrap().to_rgb8();
    let images = [
        flip_horizontal(&image),
        flip_vertical(&image),
        rotate180(&image),
        image,
    ];
    for folder in ["images", "points"] {
        std::fs::create_dir(at(folder)).unwrap();
    }
    for (name, image) in NAMES.iter().zip(images) {
        image.save(at(&format!("images/{name}.png"))).unwrap();
        let points = at(&format!("points/{name}.npy"));
        std::fs::copy(room.join("sparse.npy"), points).unwrap();
    }
    folder
}

fn complete(folder: &Path, device: &str, output: &str) -> Vec<DepthMap> {
    let mut command = Command::new(env!("CARGO_BIN_EXE_lsdc"));
    let args = ["complete", "images", "points", "--weights", "small"];
    let run = command.current_dir(folder).env_remove("LSDC_DEVICE");
    run.args(args)
        .args(["--device", device, "-o", output])
        .assert()
        .success();
    let read = |name| {
        let path = folder.join(output).join(format!("{name}_depth.npy"));
        read_npy(&path, 1.0).unwrap()
    };
    NAMES.map(read).into()
}

#[test]
fn a_folder_has_the_depths_of_the_cpu_however_many_images_are_in_flight() {
    if let Err(error) = Gpu::open(Adapter::Best) {
        assert!(
            std::env::var_os("LSDC_REQUIRE_GPU").is_none(),
            "LSDC_REQUIRE_GPU is set, but {error}"
        );
        eprintln!("skipped: {error}");
        return;
    }
    let folder = folders();
    let expected = complete(folder.path(), "cpu", "cpu");
    let found = complete(folder.path(), "wgpu", "gpu");
    assert_ne!(found[0], found[1]);
    for (found, expected) in found.iter().zip(&expected) {
        let pairs = found.values().iter().zip(expected.values());
        let squares: f64 = pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum();
        let rms = (squares / found.values().len() as f64).sqrt();
        assert!(rms < 2e-3, "{rms} m");
    }
    // Threads are scheduled differently in each run.
    assert_eq!(complete(folder.path(), "wgpu", "again"), found);
}
