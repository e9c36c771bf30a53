//! Image to basis functions, new points for kept basis functions, and all of it, at 228x304 and 500
//! points.
//!
//!     cargo bench --bench completion

use burn::tensor::Device;
use criterion::{Criterion, criterion_group, criterion_main};
use lsdc::data::{Dataset as _, Rooms, RoomsConfig, Split};
use lsdc::model::{NetworkConfig, Normalisation, Weights, WeightsRecord};
use lsdc::predict::Completer;
use lsdc::sample::Pattern;
use lsdc_core::fit::FitConfig;
use std::collections::BTreeMap;
use std::hint::black_box;

/// A network with random weights: as fast as a trained one.
fn completer(network: NetworkConfig) -> Completer {
    let device = Device::flex();
    let net = network.init(0, &device).expect("a preset");
    let record = WeightsRecord {
        network,
        normalisation: Normalisation::default(),
        notes: BTreeMap::new(),
    };
    let fit = FitConfig {
        ridge: 1e-4,
        ..FitConfig::default()
    };
    Completer::with_weights(&Weights::of(&net, record), &device)
        .expect("weights of their own network")
        .with_fit(fit)
}

fn completion(criterion: &mut Criterion) {
    let rooms = Rooms::new(Split::Val, &RoomsConfig::default()).expect("the default");
    let frame = rooms.load(0).expect("a room");
    let sparse = Pattern::Exactly(500).draw(&frame, 0).expect("a pattern");
    for (name, network) in [
        ("medium", NetworkConfig::medium()),
        ("paper", NetworkConfig::paper()),
    ] {
        let completer = completer(network);
        let bases = completer.bases(&frame.rgb).expect("an image");
        let mut group = criterion.benchmark_group(name);
        group.sample_size(20);
        group.bench_function("basis functions", |bencher| {
            bencher.iter(|| completer.bases(black_box(&frame.rgb)));
        });
        group.bench_function("fit", |bencher| {
            bencher.iter(|| completer.fit(&bases, black_box(&sparse), None));
        });
        group.bench_function("new points", |bencher| {
            bencher.iter(|| completer.complete_with(&bases, black_box(&sparse)));
        });
        group.bench_function("everything", |bencher| {
            bencher.iter(|| completer.complete(black_box(&frame.rgb), &sparse));
        });
    }
}

criterion_group!(benches, completion);
criterion_main!(benches);
