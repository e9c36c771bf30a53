//! Encoders: archives of PyTorch, whose pickles are read, and safetensors, by their first bytes.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lsdc_weights::read_encoder;
use lsdc_fuzz::with_file;

fuzz_target!(|data: &[u8]| {
    with_file(data, "f.pth", |path| {
        let _ = read_encoder(path);
    });
});
