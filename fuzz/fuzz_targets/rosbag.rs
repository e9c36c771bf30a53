//! Recordings: SQLite bags of rosbag2.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lsdc_fuzz::{recording as read, with_file};

fuzz_target!(|data: &[u8]| {
    with_file(data, "f.db3", read);
});
