//! NumPy arrays as depths and as masks.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lsdc_files::{read_mask, read_npy};
use lsdc_fuzz::with_file;

fuzz_target!(|data: &[u8]| {
    with_file(data, "f.npy", |path| {
        let _ = read_npy(path, 1.0);
        let _ = read_mask(path);
    });
});
