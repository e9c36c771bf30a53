//! JPEG and PNG colour images.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lsdc::data::read_rgb;

fuzz_target!(|data: &[u8]| {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("f");
    std::fs::write(&path, data).expect("a file");
    let _ = read_rgb(&path);
});
