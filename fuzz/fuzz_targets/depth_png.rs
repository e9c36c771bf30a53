//! 16-bit depth images.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lsdc::data::read_depth_png;

fuzz_target!(|data: &[u8]| {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("f.png");
    std::fs::write(&path, data).expect("a file");
    let _ = read_depth_png(&path, 0.001);
});
