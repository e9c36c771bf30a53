//! The check for truncated JPEG files.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lsdc_files::checks::check_jpeg;

fuzz_target!(|data: &[u8]| {
    let _ = check_jpeg(data);
    let _ = check_jpeg(&[&[0xff, 0xd8], data].concat());
});
