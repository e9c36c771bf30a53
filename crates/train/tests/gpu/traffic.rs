//! Launches and read-backs of training steps. A step on a GPU takes as long as its launches, if they are many.

use super::{gpu, room_sampler};
use lsdc_core::fit::{FitConfig, FitMethod};
use lsdc_core::network::NetworkConfig;
use lsdc_core::weights::Normalisation;
use lsdc_train::model::InitNetwork as _;
use lsdc_train::sample::{Batch, SupervisionConfig};
use lsdc_train::traffic::{Traffic, counted};
use lsdc_train::training::{Learner, LossConfig, OptimiserKind, TrainConfig, UnreadLosses};

/// Counts the second step on eight images; launches hardly depend on their size.
fn second_step(network: &NetworkConfig, config: &TrainConfig, fit: &FitConfig) -> Option<Traffic> {
    let device = gpu()?.autodiff();
    let sampler = room_sampler((48, 36), config.supervision, 8);
    let samples = sampler.batch(0).unwrap();
    let batch = [Batch::new(&samples, Normalisation::default(), &device).unwrap()];
    let net = network.init(0, &device).unwrap();
    let learner = Learner::new(net, fit, config);
    let (learner, first) = learner.step_unread(&batch, 1e-4, 1).unwrap();
    let (second, traffic) = counted(|| learner.step_unread(&batch, 1e-4, 2));
    let losses = UnreadLosses::read(vec![first, second.unwrap().1]).unwrap();
    assert!(losses.iter().all(|step| step.loss > 0.0), "{losses:?}");
    Some(traffic)
}

#[test]
fn a_step_launches_at_most_900_kernels_and_reads_nothing() {
    let fit = FitConfig {
        ridge: 1e-4,
        ..FitConfig::default()
    };
    let counts = second_step(&NetworkConfig::sharp(), &TrainConfig::default(), &fit);
    let Some(traffic) = counts else { return };
    let launches = traffic.launched();
    assert!((300..=900).contains(&launches), "{traffic:#?}");
    assert_eq!(traffic.readbacks, 0);
}

#[test]
fn a_joint_step_reads_the_fits_of_a_batch_and_their_gradient_once() {
    let fit = FitConfig {
        method: FitMethod::Joint,
        ..FitConfig::default()
    };
    let config = TrainConfig {
        optimiser: OptimiserKind::Muon,
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
    let counts = second_step(&NetworkConfig::taught(), &config, &fit);
    let Some(traffic) = counts else { return };
    // One parameter at a time, it launched 8,949 and read 700 times.
    let launches = traffic.launched();
    assert!((1000..=2800).contains(&launches), "{traffic:#?}");
    assert_eq!(traffic.readbacks, 2);
}
