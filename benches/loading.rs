//! Loading of frames: 640x480 JPEG or PNG with 16-bit PNG depths, resized to 228x304, for evaluation and, with augmentation and
//! sparse points, for training. Frames per second on all threads.
//!
//!     cargo bench --bench loading

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use lsdc_eval::data::{
    DataConfig, Dataset as _, DatasetKind, FolderConfig, Rooms, RoomsConfig, Split, write_depth_png,
};
use lsdc_eval::sampling::Protocol;
use lsdc_train::sample::{AugmentConfig, Sampler, SamplerConfig, SupervisionConfig};
use rayon::prelude::*;
use std::path::Path;

const FRAMES: usize = 16;

/// Writes rooms as `train/N.<ending>` and `train/N_depth.png`.
fn write(folder: &Path, ending: &str) {
    let folder = folder.join("train");
    std::fs::create_dir_all(&folder).expect("a folder");
    let rooms = RoomsConfig {
        width: 640,
        height: 480,
        ..RoomsConfig::default()
    };
    let rooms = Rooms::new(Split::Train, &rooms).expect("rooms");
    (0..FRAMES).into_par_iter().for_each(|i| {
        let frame = rooms.load(i).expect("a room");
        let name = |end: &str| folder.join(format!("{i:05}{end}"));
        let colours = name(&format!(".{ending}"));
        frame.rgb.save(colours).expect("a file");
        write_depth_png(&name("_depth.png"), &frame.depth, 0.001).expect("a file");
    });
}

fn loading(criterion: &mut Criterion) {
    for ending in ["jpg", "png"] {
        let folder = tempfile::tempdir().expect("a folder");
        write(folder.path(), ending);
        let config = DataConfig {
            dataset: DatasetKind::Folder,
            root: Some(folder.path().to_owned()),
            folder: FolderConfig {
                rgb: format!("{{split}}/{{frame}}.{ending}"),
                ..FolderConfig::default()
            },
            ..DataConfig::default()
        };
        let frames = config.open(Split::Train, None).expect("the frames");
        let sampler = SamplerConfig {
            protocol: Protocol::nyu(),
            augment: AugmentConfig::default(),
            views: 0,
            supervision: SupervisionConfig::default(),
            batch: 1,
            seed: 0,
        };
        let order: Vec<usize> = (0..FRAMES).collect();
        let sampler = Sampler::new(frames.clone(), order, sampler).expect("frames");

        let mut group = criterion.benchmark_group(format!("loading {ending}"));
        group.sample_size(20);
        group.throughput(Throughput::Elements(FRAMES as u64));
        group.bench_function("measuring", |bencher| {
            bencher.iter(|| {
                (0..FRAMES).into_par_iter().for_each(|i| {
                    let frame = frames.load(i).expect("a frame");
                    Protocol::nyu().apply(&frame).expect("a crop");
                });
            });
        });
        group.bench_function("training", |bencher| {
            bencher.iter(|| {
                (0..FRAMES).into_par_iter().for_each(|step| {
                    sampler.batch(step).expect("a sample");
                });
            });
        });
        group.finish();
    }
}

criterion_group!(benches, loading);
criterion_main!(benches);
