//! A training step at 228x304 with a batch of 2: forward, fit, losses, backward, Adam.
//!
//!     cargo bench --bench training

use criterion::{Criterion, criterion_group, criterion_main};
use lsdc::process::keep_pages;
use lsdc_core::fit::FitConfig;
use lsdc_core::network::NetworkConfig;
use lsdc_core::weights::Normalisation;
use lsdc_eval::data::{Rooms, RoomsConfig, Split};
use lsdc_eval::sampling::Protocol;
use lsdc_train::device::Device;
use lsdc_train::model::InitNetwork as _;
use lsdc_train::sample::{AugmentConfig, Batch, Sampler, SamplerConfig, SupervisionConfig};
use lsdc_train::training::{Learner, TrainConfig};
use std::sync::Arc;

fn batch(device: &Device) -> Batch {
    let rooms = Rooms::new(Split::Train, &RoomsConfig::default()).expect("the default");
    let config = SamplerConfig {
        protocol: Protocol::default(),
        augment: AugmentConfig::default(),
        views: 0,
        supervision: SupervisionConfig::default(),
        batch: 2,
        seed: 0,
    };
    let sampler = Sampler::new(Arc::new(rooms), vec![0, 1], config).expect("two frames");
    let samples = sampler.batch(0).expect("rooms");
    Batch::new(&samples, Normalisation::default(), device).expect("equal sizes")
}

fn step(criterion: &mut Criterion) {
    keep_pages();
    let device = Device::flex().autodiff();
    let batch = batch(&device);
    let fit = FitConfig {
        ridge: 1e-4,
        ..FitConfig::default()
    };
    let mut group = criterion.benchmark_group("training step");
    group.sample_size(10);
    for (name, network) in [
        ("sharp", NetworkConfig::sharp()),
        ("paper", NetworkConfig::paper()),
    ] {
        let net = network.init(0, &device).expect("a preset");
        let mut learner = Some(Learner::new(net, &fit, &TrainConfig::default()));
        group.bench_function(name, |bencher| {
            bencher.iter(|| {
                let before = learner.take().expect("put back below");
                let (after, step) = before
                    .step(std::slice::from_ref(&batch), 1e-4, 1)
                    .expect("a finite loss");
                learner = Some(after);
                step
            });
        });
    }
}

criterion_group!(benches, step);
criterion_main!(benches);
