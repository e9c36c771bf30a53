//! The GPU against the CPU: kernels, whole completions, and training.
//!
//! Without an adapter these tests print a message and pass; with `LSDC_REQUIRE_GPU` set they fail. A software driver (lavapipe)
//! is enough. `LSDC_DEVICE` names another device.
#![cfg(feature = "wgpu")]
#![allow(clippy::unwrap_used, clippy::print_stderr)]

mod layers;
mod lstsq;
mod traffic;

use burn::tensor::Device;
use lsdc_core::fit::{FitConfig, FitMethod};
use lsdc_core::network::{ExtractorConfig, NetworkConfig};
use lsdc_core::weights::{Normalisation, Tensor as Table};
use lsdc_core::{Completer, Weights};
use lsdc_eval::data::{Dataset as _, Rooms, RoomsConfig, Split};
use lsdc_eval::predict::complete;
use lsdc_eval::sampling::{Pattern, Protocol};
use lsdc_files::error::Result;
use lsdc_train::model::InitNetwork as _;
use lsdc_train::model::parameters::tables;
use lsdc_train::predict::{completer, plain_completer};
use lsdc_train::sample::{self, AugmentConfig, Sampler, SamplerConfig, SupervisionConfig};
use lsdc_train::training::{Learner, OptimiserKind, TrainConfig};
use std::sync::{Arc, LazyLock};

/// Returns the GPU, or a software driver if there is none.
fn gpu() -> Option<Device> {
    static FOUND: LazyLock<Option<Device>> = LazyLock::new(|| {
        let named = std::env::var("LSDC_DEVICE").ok();
        let names = named.map_or(vec!["wgpu".into(), "wgpu:software".into()], |name| {
            vec![name]
        });
        let device = lsdc_train::device::device;
        let name = names.iter().find(|name| device(name).is_ok())?;
        // Opened a second time, as by commands that open weights and systems.
        Some(device(name).unwrap())
    });
    if FOUND.is_none() {
        let required = std::env::var_os("LSDC_REQUIRE_GPU").is_some();
        assert!(
            !required,
            "LSDC_REQUIRE_GPU is set, but there is no adapter"
        );
        eprintln!("skipped: this machine has no GPU and no software driver for one");
    }
    FOUND.clone()
}

/// A function that opens weights on a device.
type Open = fn(&Weights, &Device) -> Result<Completer>;

/// Returns the largest difference relative to the largest value.
fn off(found: &[f64], expected: &[f64]) -> f64 {
    assert_eq!(found.len(), expected.len());
    assert!(found.iter().all(|v| v.is_finite()));
    let scale = expected.iter().fold(1e-30, |m: f64, v| m.max(v.abs()));
    let pairs = found.iter().zip(expected);
    pairs.fold(0.0, |m: f64, (a, b)| m.max((a - b).abs())) / scale
}

/// Samples of procedural rooms of a size (width, height), unaltered; each batch has all of `count` frames.
fn room_sampler(
    (width, height): (usize, usize),
    supervision: SupervisionConfig,
    count: usize,
) -> Sampler {
    let rooms = RoomsConfig {
        width,
        height,
        ..RoomsConfig::default()
    };
    let rooms = Rooms::new(Split::Train, &rooms).unwrap();
    let config = SamplerConfig {
        protocol: Protocol::default(),
        augment: AugmentConfig::none(),
        views: 0,
        supervision,
        batch: count,
        seed: 0,
    };
    Sampler::new(Arc::new(rooms), (0..count).collect::<Vec<_>>(), config).unwrap()
}

fn small_network(affinities: usize) -> NetworkConfig {
    NetworkConfig {
        extractor: ExtractorConfig {
            sharpening: 1,
            ..ExtractorConfig::slim()
        },
        hidden: vec![32],
        bases: 16,
        affinities,
        ..NetworkConfig::sharp()
    }
}

#[test]
fn completion_agrees() {
    let Some(gpu) = gpu() else { return };
    let rooms = Rooms::new(Split::Val, &RoomsConfig::default()).unwrap();
    let frame = rooms.load(0).unwrap();
    let sparse = Pattern::Exactly(300).draw(&frame, 0).unwrap();
    let weights = Weights::builtin();
    let on = |open: Open, device: &Device| {
        let completer = open(&weights, device).unwrap();
        let completer = completer.with_working_size(57, 76).unwrap();
        complete(&completer, &frame.rgb, &sparse)
            .unwrap()
            .depth()
            .unwrap()
    };
    let here = on(completer, &Device::flex());
    // Prepared for GPUs, and on burn's tensors.
    for open in [completer as Open, plain_completer] {
        let there = on(open, &gpu);
        let squares = here
            .values()
            .iter()
            .zip(there.values())
            .map(|(a, b)| f64::from(a - b).powi(2));
        let rms = (squares.sum::<f64>() / here.values().len() as f64).sqrt();
        assert!(rms < 2e-3, "{rms} m");
    }
    let opened = lsdc_train::device::gpu(&gpu).unwrap().unwrap();
    let launches = opened.traffic().map(|(_, traffic)| traffic.launches);
    assert!(launches.iter().sum::<u64>() > 0);
}

#[test]
fn a_batch_divided_between_cpu_and_gpu_teaches_the_same() {
    let Some(gpu) = gpu() else { return };
    let supervision = SupervisionConfig {
        points: 200,
        fewest: 100,
        draws: 2,
        patches: 4,
        patch: 8,
        ..SupervisionConfig::default()
    };
    let sampler = room_sampler((64, 48), supervision, 3);
    let network = small_network(0);
    let fit = FitConfig {
        ridge: 1e-3,
        ..FitConfig::default()
    };
    let here = Device::flex().autodiff();
    let losses = |devices: &[&Device]| {
        let net = network.init(0, &here).unwrap().freeze_statistics();
        let mut learner = Some(Learner::new(net, &fit, &TrainConfig::default()));
        (0..3)
            .map(|step| {
                let samples = sampler.batch(step).unwrap();
                let share = samples.len() / devices.len();
                let shares: Vec<_> = samples
                    .chunks(samples.len() - share * (devices.len() - 1))
                    .zip(devices)
                    .map(|(part, device)| {
                        sample::Batch::new(part, Normalisation::default(), device).unwrap()
                    })
                    .collect();
                assert_eq!(shares.len(), devices.len());
                let old = learner.take().unwrap();
                let (next, made) = old.step(&shares, 1e-2, step + 1).unwrap();
                learner = Some(next);
                made.loss
            })
            .collect::<Vec<f64>>()
    };
    let (alone, divided) = (losses(&[&here]), losses(&[&here, &gpu.autodiff()]));
    for (a, b) in alone.iter().zip(&divided) {
        assert!((a - b).abs() < 5e-3 * a, "{alone:?} {divided:?}");
    }
    assert!((alone[0] - alone[2]).abs() > 1e-2 * alone[0], "{alone:?}");
}

#[test]
fn steps_on_the_gpu_are_those_of_the_cpu() {
    let Some(gpu) = gpu() else { return };
    let supervision = SupervisionConfig {
        points: 200,
        fewest: 100,
        ..SupervisionConfig::default()
    };
    let samples = room_sampler((48, 36), supervision, 2).batch(0).unwrap();
    let network = small_network(8);
    let fit = FitConfig {
        method: FitMethod::Joint,
        ..FitConfig::default()
    };
    let config = TrainConfig {
        optimiser: OptimiserKind::Muon,
        clip: Some(0.1),
        average: Some(0.9),
        ..TrainConfig::default()
    };
    let trained = |device: &Device| {
        let device = device.clone().autodiff();
        let net = network.init(0, &device).unwrap();
        let start = tables(&net);
        let batch = [sample::Batch::new(&samples, Normalisation::default(), &device).unwrap()];
        let mut learner = Learner::new(net, &fit, &config);
        for number in 1..=2 {
            (learner, _) = learner.step(&batch, 1e-3, number).unwrap();
        }
        (start, tables(learner.net()))
    };
    let (here, there) = (trained(&Device::flex()), trained(&gpu));
    for (name, expected) in &here.1 {
        let values =
            |table: &Table| -> Vec<f64> { table.values().iter().map(|v| f64::from(*v)).collect() };
        let off = |table: &Table| off(&values(table), &values(expected));
        let moved = off(&here.0[name]);
        let off = off(&there.1[name]);
        assert!(
            off < 0.05 * moved + 1e-5,
            "{name}: {off:.1e} of {moved:.1e}"
        );
    }
}
