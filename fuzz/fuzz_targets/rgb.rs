//! JPEG and PNG colour images.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lsdc_files::read_rgb;
use lsdc_fuzz::with_file;

fuzz_target!(|data: &[u8]| {
    with_file(data, "f", |path| {
        let _ = read_rgb(path);
    });
});
