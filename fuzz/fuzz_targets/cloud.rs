//! Clouds: PLY, PCD, LAS, LAZ, bin and xyz, by the first byte.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lsdc_files::{Camera, Sparse};
use lsdc_fuzz::with_file;

fuzz_target!(|data: &[u8]| {
    let Some((&kind, data)) = data.split_first() else {
        return;
    };
    let name = ["f.ply", "f.pcd", "f.las", "f.laz", "f.bin", "f.xyz"][usize::from(kind % 6)];
    let camera = Camera::pinhole([50.0; 2], [32.0, 24.0]);
    with_file(data, name, |path| {
        let _ = Sparse::read(path, None, Some(&camera), (64, 48));
    });
});
