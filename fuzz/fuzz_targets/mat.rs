//! Labelled MATLAB v7.3 files.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lsdc::data::{DataConfig, DatasetKind, Split};

fuzz_target!(|data: &[u8]| {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("labelled.mat");
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
