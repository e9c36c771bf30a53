//! Cameras: TOML, JSON and YAML, by the first byte.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lsdc_files::Camera;
use lsdc_fuzz::with_one_of;

fuzz_target!(|data: &[u8]| {
    with_one_of(data, &["f.toml", "f.json", "f.yaml"], |path| {
        if let Ok(camera) = Camera::read(path) {
            let _ = camera.project([0.1, 0.2, 3.0]);
            let _ = camera.unproject([1.0, 2.0], 3.0);
        }
    });
});
