//! One step of training.

use super::average::follow;
use super::config::{OptimiserKind, Part};
use super::imitation::Shown;
use super::loss::{field_losses, system_losses};
use super::muon::Flattened;
use super::parallel::gradients;
use super::step::Step;
use super::{LossConfig, Losses, TrainConfig, losses};
use crate::error::{Cause, Error, Result};
use crate::model::BasisNet;
use crate::model::layers::FreezeStatistics;
use crate::ops::Reweighting;
use crate::sample::Batch;
use crate::systems::Net;
use burn::grad_clipping::GradientClippingConfig;
use burn::module::{Module, ParamGroup};
use burn::optim::decay::WeightDecayConfig;
use burn::optim::momentum::MomentumConfig;
use burn::optim::{AdamConfig, GradientsParams, ModuleOptimizer, SgdConfig};
use lsdc_core::fit::FitConfig;

/// What a step asks of a network.
pub trait Objective<M>: Sync {
    /// The losses of a batch.
    fn losses(&self, net: &M, batch: &Batch) -> Losses;
}

/// Basis functions whose fits are near the depths.
pub struct Fitting {
    fit: FitConfig,
    robust: Option<Reweighting>,
    loss: LossConfig,
    part: Part,
    /// The network of a teacher, which is compared with.
    teacher: Option<BasisNet>,
}

impl Objective<BasisNet> for Fitting {
    fn losses(&self, net: &BasisNet, batch: &Batch) -> Losses {
        let shown = self.teacher.as_ref().map(|teacher| {
            let device = batch.images.device().inner();
            Shown::new(&teacher.clone().to_device(&device), batch, &self.loss)
        });
        let (shown, fit, loss) = (shown.as_ref(), &self.fit, &self.loss);
        match self.part {
            Part::All | Part::Bases => losses(net, batch, shown, fit, self.robust, loss),
            Part::Affinities => field_losses(net, batch, shown, fit, loss),
        }
    }
}

/// A system whose depths are near those that are to be found.
pub struct Predicting {
    loss: LossConfig,
}

impl Objective<Net> for Predicting {
    fn losses(&self, net: &Net, batch: &Batch) -> Losses {
        system_losses(net, batch, &self.loss)
    }
}

/// A network with its optimiser, and what it is to learn.
pub struct Learner<M = BasisNet, O = Fitting> {
    pub(super) net: M,
    pub(super) optimiser: ModuleOptimizer,
    objective: O,
    /// The average over steps, and how much of it is kept in one.
    pub(super) average: Option<(M, f64)>,
}

impl Learner {
    /// Starts with a network on an autodiff device, and the optimiser of `config`.
    pub fn new(net: BasisNet, fit: &FitConfig, config: &TrainConfig) -> Self {
        let net = match config.part {
            Part::All | Part::Affinities => net,
            Part::Bases => net.fix_affinities(),
        };
        let objective = Fitting {
            fit: *fit,
            robust: config.robust,
            loss: config.loss,
            part: config.part,
            teacher: None,
        };
        Self::with(net, objective, config)
    }

    /// Compares the network with that of a teacher, as far as losses ask for it: one for images of the same size and
    /// normalisation, not on an autodiff device.
    #[must_use]
    pub fn taught_by(mut self, teacher: Option<BasisNet>) -> Self {
        self.objective.teacher = teacher;
        self
    }
}

impl Learner<Net, Predicting> {
    /// Starts with a system on an autodiff device, and the optimiser of `config`.
    pub fn of_system(net: Net, config: &TrainConfig) -> Self {
        let objective = Predicting { loss: config.loss };
        Self::with(net, objective, config)
    }
}

impl<M: Module, O: Objective<M>> Learner<M, O> {
    fn with(net: M, objective: O, config: &TrainConfig) -> Self {
        let decay = WeightDecayConfig::new(config.weight_decay);
        let clip = config.clip.map(GradientClippingConfig::Norm);
        let adam = AdamConfig::new()
            .with_epsilon(1e-8)
            .with_weight_decay(Some(decay.clone()))
            .with_grad_clipping(clip.clone());
        let optimiser = match config.optimiser {
            OptimiserKind::Adam => adam.init(),
            OptimiserKind::Sgd => {
                let momentum = MomentumConfig::new().with_momentum(0.9).with_dampening(0.0);
                SgdConfig::new()
                    .with_weight_decay(Some(decay))
                    .with_momentum(Some(momentum))
                    .with_gradient_clipping(clip)
                    .init()
            }
            // The name that layers give what they multiply with.
            OptimiserKind::Muon => {
                let group = ParamGroup::from_predicate("weight");
                adam.init().with_group(group, Flattened::new(), None)
            }
        };
        Self {
            average: config.average.map(|decay| (net.clone(), decay)),
            net,
            optimiser,
            objective,
        }
    }

    /// The network to be used: its average over steps, or as it is now.
    pub fn net(&self) -> &M {
        self.average.as_ref().map_or(&self.net, |(net, _)| net)
    }

    /// Lets batch normalisation use its running statistics from now on.
    #[must_use]
    pub fn freeze_statistics(mut self) -> Self {
        self.net = self.net.map(&mut FreezeStatistics);
        self
    }

    /// One step with a learning rate, of this number, counted from 1: on one batch, or on
    /// shares of it on several devices, the first of them that of the network.
    ///
    /// # Errors
    /// No share, or a loss that is not finite.
    pub fn step(mut self, shares: &[Batch], rate: f64, number: usize) -> Result<(Self, Step)> {
        let objective = &self.objective;
        let (gradients, step) = gradients(&self.net, shares, |net, batch, part| {
            descent(objective, net, batch, part)
        })?;
        self.net = self.optimiser.step(rate, self.net, gradients);
        self.average = self
            .average
            .map(|(average, decay)| (follow(average, &self.net, decay, number), decay));
        Ok((self, step))
    }
}

/// Gradients of the loss times `part`, and the losses.
fn descent<M: Module>(
    objective: &impl Objective<M>,
    net: &M,
    batch: &Batch,
    part: f64,
) -> Result<(GradientsParams, Step)> {
    let losses = objective.losses(net, batch);
    let step = Step::of(&losses);
    if [step.loss, step.l1, step.l2].iter().any(|v| !v.is_finite()) {
        return Err(Error::new(Cause::Fit, "the loss is no longer finite").hint(
            "lower `train.learning_rate`, set `train.clip`, or give the fit a `ridge`; \
             training goes on from the last checkpoint",
        ));
    }
    let gradients = (losses.total * part).backward();
    Ok((GradientsParams::from_grads(gradients, net), step))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::{Rooms, RoomsConfig, Split};
    use crate::model::{
        ExtractorConfig, InitNetwork as _, NetworkConfig, Normalisation, weights_of,
    };
    use crate::sample::{AugmentConfig, Protocol, Sampler, SamplerConfig, SupervisionConfig};
    use burn::tensor::Device;
    use lsdc_core::fit::FitMethod;
    use std::sync::Arc;

    #[test]
    fn basis_functions_are_trained_without_the_affinities() {
        let rooms = RoomsConfig {
            width: 48,
            height: 36,
            ..RoomsConfig::default()
        };
        let rooms = Arc::new(Rooms::new(Split::Train, &rooms).unwrap());
        let config = TrainConfig {
            part: Part::Bases,
            loss: LossConfig {
                regularisation: 0.0,
                ..LossConfig::default()
            },
            ..TrainConfig::default()
        };
        let sampler = SamplerConfig {
            protocol: Protocol::default(),
            augment: AugmentConfig::none(),
            views: 0,
            supervision: SupervisionConfig {
                points: 40,
                fewest: 5,
                ..SupervisionConfig::default()
            },
            batch: 2,
            seed: 0,
        };
        let samples = Sampler::new(rooms, vec![0, 1], sampler)
            .unwrap()
            .batch(0)
            .unwrap();
        let device = Device::flex().autodiff();
        let Normalisation {
            mean, deviation, ..
        } = Normalisation::default();
        let batch = Batch::new(&samples, mean, deviation, &device).unwrap();
        let network = NetworkConfig {
            extractor: ExtractorConfig {
                // It begins with zeros, behind which nothing moves in the first step.
                sharpening: 0,
                ..ExtractorConfig::slimmer()
            },
            hidden: vec![16],
            bases: 12,
            affinities: 8,
            ..NetworkConfig::sharp()
        };
        let fit = FitConfig {
            method: FitMethod::Joint,
            ..FitConfig::default()
        };
        let tensors = |net: &BasisNet| {
            weights_of(&net.valid(), network.clone(), Normalisation::default()).tensors
        };
        let net = network.init(0, &device).unwrap();
        let before = tensors(&net);
        let learner = Learner::new(net, &fit, &config);
        let (learner, _) = learner.step(&[batch], 1e-2, 1).unwrap();
        let after = tensors(learner.net());
        for (name, tensor) in &before {
            let same = after[name] == *tensor;
            assert_eq!(same, name.starts_with("edges."), "{name}");
        }
    }
}
