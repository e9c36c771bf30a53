//! Text tables of points, as pixels and as a cloud.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lsdc_files::{Camera, Sparse};
use lsdc_fuzz::with_file;

fuzz_target!(|data: &[u8]| {
    with_file(data, "f.csv", |path| {
        let _ = Sparse::read(path, None, None, (64, 48));
        let camera = Camera::pinhole([50.0; 2], [32.0, 24.0]);
        let _ = Sparse::read(path, None, Some(&camera), (64, 48));
    });
});
