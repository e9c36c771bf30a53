//! HDF5 files of the sparse-to-dense tree.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lsdc_eval::data::DatasetKind;
use lsdc_fuzz::with_dataset;

fuzz_target!(|data: &[u8]| {
    with_dataset(data, "val/official/00001.h5", DatasetKind::Nyu);
});
