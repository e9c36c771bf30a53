//! HDF5 files of the sparse-to-dense tree.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lsdc::data::{DataConfig, DatasetKind, Split};

fuzz_target!(|data: &[u8]| {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("val/official/00001.h5");
    std::fs::create_dir_all(path.parent().expect("a parent")).expect("folders");
    std::fs::write(&path, data).expect("a file");
    let config = DataConfig {
        dataset: DatasetKind::Nyu,
        root: Some(folder.path().to_owned()),
        ..DataConfig::default()
    };
    if let Ok(frames) = config.open(Split::Val, None) {
        for i in 0..frames.len().min(3) {
            let _ = frames.load(i);
        }
    }
});
