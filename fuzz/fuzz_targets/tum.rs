//! Association lists of TUM RGB-D.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lsdc_eval::data::DatasetKind;
use lsdc_fuzz::with_dataset;

fuzz_target!(|data: &[u8]| {
    with_dataset(data, "associations.txt", DatasetKind::Tum);
});
