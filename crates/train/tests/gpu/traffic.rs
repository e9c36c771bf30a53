//! Launches and read-backs of training steps.

use super::gpu;
use lsdc_core::fit::FitConfig;
use lsdc_core::fit::FitMethod;
use lsdc_core::network::NetworkConfig;
use lsdc_core::weights::Normalisation;
use lsdc_eval::data::{Rooms, RoomsConfig, Split};
use lsdc_eval::sampling::Protocol;
use lsdc_train::model::InitNetwork as _;
use lsdc_train::sample::{AugmentConfig, Batch, Sampler, SamplerConfig, SupervisionConfig};
use lsdc_train::traffic::{Traffic, counted};
use lsdc_train::training::{Learner, LossConfig, OptimiserKind, TrainConfig, UnreadLosses};
use std::sync::Arc;

/// Counts the third step on eight small images; launches hardly depend on the size.
fn third_step(network: &NetworkConfig, config: &TrainConfig, fit: &FitConfig) -> Option<Traffic> {
    let device = gpu()?.autodiff();
    let rooms = RoomsConfig {
        width: 64,
        height: 48,
        ..RoomsConfig::default()
    };
    let rooms = Arc::new(Rooms::new(Split::Train, &rooms).unwrap());
    let sampler = SamplerConfig {
        protocol: Protocol::default(),
        augment: AugmentConfig::none(),
        views: 0,
        supervision: SupervisionConfig {
            patch: 8,
            ..config.supervision
        },
        batch: 8,
        seed: 0,
    };
    let sampler = Sampler::new(rooms, (0..8).collect::<Vec<_>>(), sampler).unwrap();
    let samples = sampler.batch(0).unwrap();
    let batch = Batch::new(&samples, Normalisation::default(), &device).unwrap();
    let net = network.init(0, &device).unwrap();
    let mut learner = Learner::new(net, fit, config).freeze_statistics();
    let mut counts = Traffic::default();
    for number in 1..=3 {
        let step = || learner.step_unread(std::slice::from_ref(&batch), 1e-4, number);
        let (made, traffic) = counted(step);
        let losses;
        (learner, losses) = made.unwrap();
        UnreadLosses::read(vec![losses]).unwrap();
        counts = traffic;
    }
    Some(counts)
}

#[test]
fn a_step_launches_few_kernels() {
    let fit = FitConfig {
        ridge: 1e-4,
        ..FitConfig::default()
    };
    let Some(found) = third_step(&NetworkConfig::sharp(), &TrainConfig::default(), &fit) else {
        return;
    };
    let mut groups: Vec<_> = found.launches.iter().collect();
    groups.sort_by_key(|(_, n)| std::cmp::Reverse(**n));
    eprintln!(
        "{} launches, {} readbacks",
        found.launched(),
        found.readbacks
    );
    for (name, n) in groups {
        eprintln!("{n:6} {name}");
    }
    assert!(found.launched() > 0);
}

#[test]
fn a_taught_step() {
    let fit = FitConfig {
        method: FitMethod::Joint,
        ..FitConfig::default()
    };
    let config = TrainConfig {
        optimiser: OptimiserKind::Muon,
        weight_decay: 0.0,
        clip: Some(1.0),
        average: Some(0.99),
        supervision: SupervisionConfig {
            points: 100,
            fewest: 5,
            draws: 2,
            patches: 8,
            patch: 8,
            ..SupervisionConfig::default()
        },
        loss: LossConfig {
            affinities: 0.01,
            balance: 0.25,
            ..LossConfig::default()
        },
        ..TrainConfig::default()
    };
    let network = NetworkConfig::taught();
    let Some(found) = third_step(&network, &config, &fit) else {
        return;
    };
    let mut groups: Vec<_> = found.launches.iter().collect();
    groups.sort_by_key(|(_, n)| std::cmp::Reverse(**n));
    eprintln!(
        "{} launches, {} readbacks",
        found.launched(),
        found.readbacks
    );
    for (name, n) in groups.into_iter().take(14) {
        eprintln!("{n:6} {}", &name[..name.len().min(90)]);
    }
}
