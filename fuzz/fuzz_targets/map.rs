//! Depth maps: npz, TIFF, EXR, PFM, PGM and HDF5, by the first byte.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lsdc::data::Sparse;
use lsdc_fuzz::with_file;

fuzz_target!(|data: &[u8]| {
    let Some((&kind, data)) = data.split_first() else {
        return;
    };
    let name = ["f.npz", "f.tiff", "f.exr", "f.pfm", "f.pgm", "f.h5"][usize::from(kind % 6)];
    with_file(data, name, |path| {
        let _ = Sparse::read(path, None, None, (64, 48));
    });
});
