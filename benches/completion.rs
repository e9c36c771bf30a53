//! Basis functions from an image, new points with cached basis functions, and both together, at 228x304 with 500 points.
//!
//!     cargo bench --bench completion

use criterion::{Criterion, criterion_group, criterion_main};
use lsdc_core::network::NetworkConfig;
use lsdc_core::settings::FitConfig;
use lsdc_core::weights::Normalisation;
use lsdc_core::{Completer, Observations};
use lsdc_eval::data::{Dataset as _, Rooms, RoomsConfig, Split};
use lsdc_eval::predict::scene;
use lsdc_eval::sampling::Pattern;
use lsdc_train::device::Device;
use lsdc_train::model::{InitNetwork as _, weights_of};
use std::hint::black_box;

/// A completer with random weights, as fast as trained ones.
fn completer(network: NetworkConfig) -> Completer {
    let device = Device::flex();
    let net = network.init(0, &device).expect("a preset");
    let weights = weights_of(&net, network, Normalisation::default());
    let fit = FitConfig {
        ridge: 1e-4,
        ..FitConfig::default()
    };
    let completer = Completer::builder(&weights).fit(fit).build();
    completer.expect("weights of their own network")
}

fn completion(criterion: &mut Criterion) {
    let rooms = Rooms::new(Split::Val, &RoomsConfig::default()).expect("the default");
    let frame = rooms.load(0).expect("a room");
    let sparse = Pattern::Exactly(500).draw(&frame, 0).expect("a pattern");
    let points = Observations::from_map(&sparse);
    for (name, network) in [
        ("medium", NetworkConfig::medium()),
        ("paper", NetworkConfig::paper()),
    ] {
        let completer = completer(network);
        let prepared = scene(&completer, &frame.rgb).expect("an image");
        let mut group = criterion.benchmark_group(name);
        group.sample_size(20);
        group.bench_function("scene", |bencher| {
            bencher.iter(|| scene(&completer, black_box(&frame.rgb)));
        });
        group.bench_function("fit", |bencher| {
            bencher.iter(|| prepared.complete(black_box(&points)));
        });
        group.bench_function("new points", |bencher| {
            bencher.iter(|| prepared.complete(black_box(&points))?.depth());
        });
        group.bench_function("everything", |bencher| {
            bencher.iter(|| {
                let prepared = scene(&completer, black_box(&frame.rgb))?;
                lsdc_files::error::Result::Ok(prepared.complete(&points)?.depth()?)
            });
        });
    }
}

criterion_group!(benches, completion);
criterion_main!(benches);
