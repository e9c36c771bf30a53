//! A training step.

use super::average::follow;
use super::config::TrainedPart;
use super::loss::{field_losses, map_losses};
use super::optimiser::Optimiser;
use super::parallel::gradients;
use super::step::{StepLosses, UnreadLosses};
use super::{LossConfig, Losses, TeacherOutput, TrainConfig, losses};
use crate::model::BasisNet;
use crate::model::layers::FreezeStatistics;
use crate::ops::Reweighting;
use crate::sample::Batch;
use burn::module::Module;
use burn::optim::GradientsParams;
use lsdc_core::fit::FitConfig;
use lsdc_files::error::Result;

/// The losses minimised by a step.
pub trait Objective<M>: Sync {
    /// Computes the losses of a batch.
    ///
    /// # Errors
    /// The batch lacks an input of the network.
    fn losses(&self, net: &M, batch: &Batch) -> Result<Losses>;
}

/// Training of basis functions by comparing fits with the depths.
pub struct FitObjective {
    fit: FitConfig,
    robust: Option<Reweighting>,
    loss: LossConfig,
    part: TrainedPart,
    /// Network of a teacher, to compare with.
    teacher: Option<BasisNet>,
}

impl Objective<BasisNet> for FitObjective {
    fn losses(&self, net: &BasisNet, batch: &Batch) -> Result<Losses> {
        let teacher = self.teacher.as_ref().map(|teacher| {
            let device = batch.images.device().inner();
            TeacherOutput::new(&teacher.clone().to_device(&device), batch, &self.loss)
        });
        let (teacher, fit, loss) = (teacher.as_ref(), &self.fit, &self.loss);
        Ok(match self.part {
            TrainedPart::All | TrainedPart::Bases => {
                losses(net, batch, teacher, fit, self.robust, loss)
            }
            TrainedPart::Affinities => field_losses(net, batch, teacher, fit, loss),
            TrainedPart::Map => map_losses(net, batch, loss)?,
        })
    }
}

/// A network with its optimiser and objective.
pub struct Learner<M = BasisNet, O = FitObjective> {
    pub(super) net: M,
    pub(super) optimiser: Optimiser,
    objective: O,
    /// Running average over steps, and its decay per step.
    pub(super) average: Option<(M, f64)>,
}

impl Learner {
    /// Creates a learner from a network on an autodiff device, with the optimiser of `config`.
    pub fn new(net: BasisNet, fit: &FitConfig, config: &TrainConfig) -> Self {
        let net = match config.part {
            // With affinities or a map alone, only trained parts are run.
            TrainedPart::All | TrainedPart::Affinities | TrainedPart::Map => net,
            TrainedPart::Bases => net.fix_affinities(),
        };
        let objective = FitObjective {
            fit: *fit,
            robust: config.robust,
            loss: config.loss,
            part: config.part,
            teacher: None,
        };
        Self::with(net, objective, config)
    }

    /// Sets the network of a teacher, for the losses that compare with it: for images of the same size and normalisation, not
    /// on an autodiff device.
    #[must_use]
    pub fn with_teacher(mut self, teacher: Option<BasisNet>) -> Self {
        self.objective.teacher = teacher;
        self
    }
}

impl<M: Module, O: Objective<M>> Learner<M, O> {
    /// Creates a learner from a network on an autodiff device and an objective, with the optimiser of `config`.
    pub fn with(net: M, objective: O, config: &TrainConfig) -> Self {
        Self {
            average: config.average.map(|decay| (net.clone(), decay)),
            net,
            optimiser: Optimiser::new(config),
            objective,
        }
    }

    /// Returns the network for inference: the average over steps, or the current one.
    pub fn net(&self) -> &M {
        self.average.as_ref().map_or(&self.net, |(net, _)| net)
    }

    /// Makes batch normalisation use its running statistics from now on.
    #[must_use]
    pub fn freeze_statistics(mut self) -> Self {
        self.net = self.net.map(&mut FreezeStatistics);
        self
    }

    /// Takes a step with a learning rate, and reads its losses; `number` counts steps from 1. The batch may be divided among
    /// several devices, the first of which is that of the network.
    ///
    /// # Errors
    /// There is no share, or the loss is not finite.
    pub fn step(self, shares: &[Batch], rate: f64, number: usize) -> Result<(Self, StepLosses)> {
        let (after, losses) = self.step_unread(shares, rate, number)?;
        let read = UnreadLosses::read(vec![losses])?;
        Ok((after, read[0]))
    }

    /// Takes a step like [`step`](Self::step), but leaves the losses on the device, so that a GPU need not complete it first.
    ///
    /// # Errors
    /// There is no share.
    pub fn step_unread(
        mut self,
        shares: &[Batch],
        rate: f64,
        number: usize,
    ) -> Result<(Self, UnreadLosses)> {
        let objective = &self.objective;
        let (gradients, losses) = gradients(&self.net, shares, |net, batch, part| {
            descent(objective, net, batch, part)
        })?;
        self.net = self.optimiser.step(rate, self.net, gradients);
        self.average = self
            .average
            .map(|(average, decay)| (follow(average, &self.net, decay, number), decay));
        Ok((self, losses))
    }
}

/// Computes the gradients of the loss times `part`, and the losses.
fn descent<M: Module>(
    objective: &impl Objective<M>,
    net: &M,
    batch: &Batch,
    part: f64,
) -> Result<(GradientsParams, UnreadLosses)> {
    let losses = objective.losses(net, batch)?;
    let step = UnreadLosses::of(&losses);
    let gradients = (losses.total * part).backward();
    Ok((GradientsParams::from_grads(gradients, net), step))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{InitNetwork as _, weights_of};
    use crate::sample::{AugmentConfig, Sampler, SamplerConfig, SupervisionConfig};
    use crate::training::OptimiserKind;
    use burn::tensor::Device;
    use lsdc_core::fit::FitMethod;
    use lsdc_core::network::{BackboneConfig, ExtractorConfig, NetworkConfig};
    use lsdc_core::weights::Normalisation;
    use lsdc_core::weights::Tensor as Table;
    use lsdc_eval::data::{Rooms, RoomsConfig, Split};
    use lsdc_eval::sampling::Protocol;
    use std::collections::BTreeMap;
    use std::sync::Arc;

    fn fit() -> FitConfig {
        FitConfig {
            method: FitMethod::Joint,
            ..FitConfig::default()
        }
    }

    fn config(part: TrainedPart) -> TrainConfig {
        TrainConfig {
            part,
            loss: LossConfig {
                regularisation: 0.0,
                ..LossConfig::default()
            },
            ..TrainConfig::default()
        }
    }

    /// Returns a batch of two rooms.
    fn batch(device: &Device) -> Batch {
        let rooms = RoomsConfig {
            width: 48,
            height: 36,
            ..RoomsConfig::default()
        };
        let rooms = Arc::new(Rooms::new(Split::Train, &rooms).unwrap());
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
        let sampler = Sampler::new(rooms, vec![0, 1], sampler).unwrap();
        let samples = sampler.batch(0).unwrap();
        Batch::new(&samples, Normalisation::default(), device).unwrap()
    }

    fn network() -> NetworkConfig {
        NetworkConfig {
            extractor: ExtractorConfig {
                // Sharpening is initialised to zero, so that its inputs have no gradient in the first step.
                sharpening: 0,
                ..ExtractorConfig::slimmer()
            },
            hidden: vec![16],
            bases: 12,
            affinities: 8,
            ..NetworkConfig::sharp()
        }
    }

    fn tensors(net: &BasisNet, network: &NetworkConfig) -> BTreeMap<String, Table> {
        weights_of(&net.valid(), network.clone(), Normalisation::default()).tensors
    }

    #[test]
    fn basis_functions_are_trained_without_the_affinities() {
        let (network, device) = (network(), Device::flex().autodiff());
        let net = network.init(0, &device).unwrap();
        let before = tensors(&net, &network);
        let learner = Learner::new(net, &fit(), &config(TrainedPart::Bases));
        let (learner, _) = learner.step(&[batch(&device)], 1e-2, 1).unwrap();
        let after = tensors(learner.net(), &network);
        for (name, tensor) in &before {
            let same = after[name] == *tensor;
            assert_eq!(same, name.starts_with("edges."), "{name}");
        }
    }

    #[test]
    fn a_map_is_trained_without_the_rest() {
        let device = Device::flex().autodiff();
        let mut network = network();
        network.mean = true;
        network.extractor.sharpening = 2;
        network.extractor.backbone = Some(BackboneConfig {
            stages: 3,
            decoder: 16,
        });
        let mut config = config(TrainedPart::Map);
        assert!(config.check().is_err(), "other losses would have no effect");
        config.loss = LossConfig::of_map(1.0);
        let batch = batch(&device);
        let net = network.init(0, &device).unwrap();
        let before = tensors(&net, &network);
        let mut learner = Learner::new(net, &fit(), &config).freeze_statistics();
        let mut steps = Vec::new();
        for number in 1..=30 {
            let step;
            (learner, step) = learner
                .step(std::slice::from_ref(&batch), 3e-3, number)
                .unwrap();
            steps.push(step);
        }
        assert!(steps[29].loss < 0.8 * steps[0].loss, "{steps:?}");
        assert_eq!(steps[29].l1, 0.0);
        let after = tensors(learner.net(), &network);
        for (name, tensor) in &before {
            let own = name.starts_with("extractor.backbone.")
                || (name.starts_with("extractor.decoder.") && !name.contains(".features."));
            assert!(own || after[name] == *tensor, "{name}");
        }
        assert_ne!(
            after["extractor.decoder.map.weight"],
            before["extractor.decoder.map.weight"]
        );
        // The map is the first basis function.
        let (net, images) = (learner.net(), batch.images.clone());
        let map = net.map_at(images.clone(), batch.size, &batch.pixels);
        let bases = net.bases(images, None).at(batch.size, &batch.pixels);
        let first = bases.narrow(2, 0, 1).squeeze_dim::<2>(2);
        let off = (map.unwrap() - first).abs().max().into_scalar::<f32>();
        assert!(off < 1e-5, "{off}");
    }

    #[test]
    fn a_backbone_moves_by_its_share_of_the_rate() {
        let device = Device::flex().autodiff();
        let mut network = network();
        network.extractor.backbone = Some(BackboneConfig {
            stages: 3,
            decoder: 16,
        });
        let net = network.init(0, &device).unwrap();
        let before = tensors(&net, &network);
        let mut config = config(TrainedPart::Bases);
        config.optimiser = OptimiserKind::Muon;
        config.backbone.rate = 0.05;
        config.weight_decay = 0.0;
        let mut learner = Learner::new(net, &fit(), &config).freeze_statistics();
        // In the first step, the following layers are zero, so it has no gradient.
        for number in 1..=2 {
            (learner, _) = learner.step(&[batch(&device)], 1e-2, number).unwrap();
        }
        let after = tensors(learner.net(), &network);
        let mut moved = 0;
        for (name, tensor) in &before {
            if !name.starts_with("extractor.backbone.") {
                continue;
            }
            let pairs = tensor.values().iter().zip(after[name].values());
            let most = pairs.fold(0.0_f32, |most, (a, b)| most.max((a - b).abs()));
            // The first step of Adam with a gradient is at most as large as the rate.
            assert!(most < 1.01 * 0.05 * 1e-2, "{name}: {most}");
            moved += usize::from(most > 0.0);
        }
        assert!(moved > 10, "{moved}");
    }
}
