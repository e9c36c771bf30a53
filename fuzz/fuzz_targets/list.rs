//! Lists of points as text.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lsdc::data::Sparse;
use lsdc_fuzz::with_file;

fuzz_target!(|data: &[u8]| {
    with_file(data, "f.csv", |path| {
        let _ = Sparse::read(path, None, None, (64, 48));
    });
});
