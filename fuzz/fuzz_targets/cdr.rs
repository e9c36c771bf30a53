//! Messages of recordings, by the first byte.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lsdc_recordings::fuzzing::message;

fuzz_target!(|data: &[u8]| {
    if let Some((&kind, data)) = data.split_first() {
        message(kind, data);
    }
});
