//! Messages on the topics of a node in any order: each image is returned once, regardless of earlier messages.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lsdc_recordings::fuzzing::live;

fuzz_target!(|data: &[u8]| {
    let [images, returned, _] = live(data);
    assert_eq!(images, returned);
});
