//! Clouds: PLY, PCD, LAS, LAZ, bin and xyz, by the first byte.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lsdc_files::{Camera, Sparse};
use lsdc_fuzz::with_one_of;

fuzz_target!(|data: &[u8]| {
    let names = ["f.ply", "f.pcd", "f.las", "f.laz", "f.bin", "f.xyz"];
    let camera = Camera::pinhole([50.0; 2], [32.0, 24.0]);
    with_one_of(data, &names, |path| {
        let _ = Sparse::read(path, None, Some(&camera), (64, 48));
    });
});
