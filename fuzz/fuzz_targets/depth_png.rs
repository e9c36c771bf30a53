//! 16-bit depth images.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lsdc_files::read_depth_png;
use lsdc_fuzz::with_file;

fuzz_target!(|data: &[u8]| {
    with_file(data, "f.png", |path| {
        let _ = read_depth_png(path, 0.001);
    });
});
