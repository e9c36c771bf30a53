//! Depth maps: npz, TIFF, EXR, PFM, PGM, HDF5 and PNG, by the first byte, as depths along the axis and along the ray.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lsdc_files::{Camera, DepthKind, DepthReadOptions, Sparse};
use lsdc_fuzz::with_one_of;

fuzz_target!(|data: &[u8]| {
    let names = [
        "f.npz", "f.tiff", "f.exr", "f.pfm", "f.pgm", "f.h5", "f.png",
    ];
    let is_ray = data.first().is_some_and(|&kind| kind > 127);
    let options = DepthReadOptions {
        unit: None,
        kind: is_ray.then_some(DepthKind::Ray),
    };
    let camera = Camera::pinhole([50.0; 2], [32.0, 24.0]);
    with_one_of(data, &names, |path| {
        let _ = Sparse::read_as(path, options, Some(&camera), (64, 48));
    });
});
