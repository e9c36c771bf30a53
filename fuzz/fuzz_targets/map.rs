//! Depth maps: npz, TIFF, EXR, PFM, PGM, HDF5 and PNG, by the first byte, as depths along the axis and along the ray.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lsdc_files::{Camera, DepthKind, Sparse, StoredAs};
use lsdc_fuzz::with_file;

fuzz_target!(|data: &[u8]| {
    let Some((&kind, data)) = data.split_first() else {
        return;
    };
    let name = ["f.npz", "f.tiff", "f.exr", "f.pfm", "f.pgm", "f.h5", "f.png"][usize::from(kind % 7)];
    let ray = StoredAs {
        unit: None,
        kind: (kind > 127).then_some(DepthKind::Ray),
    };
    let camera = Camera::pinhole([50.0; 2], [32.0, 24.0]);
    with_file(data, name, |path| {
        let _ = Sparse::read_as(path, ray, Some(&camera), (64, 48));
    });
});
