//! NumPy arrays as depths and as masks.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lsdc::data::{read_mask, read_npy};

fuzz_target!(|data: &[u8]| {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("f.npy");
    std::fs::write(&path, data).expect("a file");
    let _ = read_npy(&path, 1.0);
    let _ = read_mask(&path);
});
