//! One step of training.

use super::average::follow;
use super::config::Part;
use super::loss::field_losses;
use super::{LossConfig, TrainConfig, losses};
use crate::error::{Cause, Error, Result};
use crate::fit::{FitConfig, Reweighting};
use crate::model::BasisNet;
use crate::sample::Batch;
use burn::grad_clipping::GradientClippingConfig;
use burn::optim::decay::WeightDecayConfig;
use burn::optim::{AdamConfig, GradientsParams, ModuleOptimizer};
use burn::tensor::Tensor;

/// A network with its optimiser.
pub struct Learner {
    pub(super) net: BasisNet,
    pub(super) optimiser: ModuleOptimizer,
    fit: FitConfig,
    robust: Option<Reweighting>,
    loss: LossConfig,
    part: Part,
    /// The average over steps, and how much of it is kept in one.
    pub(super) average: Option<(BasisNet, f64)>,
}

/// The losses of one batch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// The weighted sum.
    pub loss: f64,
    /// Mean absolute error in metres.
    pub l1: f64,
    /// Mean squared error in square metres.
    pub l2: f64,
}

impl Learner {
    /// Starts with a network on an autodiff device, and Adam as `config` has it.
    pub fn new(net: BasisNet, fit: &FitConfig, config: &TrainConfig) -> Self {
        let decay = WeightDecayConfig::new(config.weight_decay);
        let optimiser = AdamConfig::new()
            .with_epsilon(1e-8)
            .with_weight_decay(Some(decay))
            .with_grad_clipping(config.clip.map(GradientClippingConfig::Norm))
            .init();
        Self {
            average: config.average.map(|decay| (net.clone(), decay)),
            net,
            optimiser,
            fit: *fit,
            robust: config.robust,
            loss: config.loss,
            part: config.part,
        }
    }

    /// The network to be used: its average over steps, or as it is now.
    pub fn net(&self) -> &BasisNet {
        self.average.as_ref().map_or(&self.net, |(net, _)| net)
    }

    /// Lets batch normalisation use its running statistics from now on.
    #[must_use]
    pub fn freeze_statistics(mut self) -> Self {
        self.net = self.net.freeze_statistics();
        self
    }

    /// One step of Adam with a learning rate, of this number, counted from 1.
    ///
    /// # Errors
    /// A loss that is not finite.
    pub fn step(mut self, batch: &Batch, rate: f64, number: usize) -> Result<(Self, Step)> {
        let losses = match self.part {
            Part::All => losses(&self.net, batch, &self.fit, self.robust, &self.loss),
            Part::Edges => field_losses(&self.net, batch, &self.fit, &self.loss),
        };
        let value = |t: &Tensor<1>| t.clone().into_scalar::<f32>().into();
        let step = Step {
            loss: value(&losses.total),
            l1: value(&losses.l1),
            l2: value(&losses.l2),
        };
        if [step.loss, step.l1, step.l2].iter().any(|v| !v.is_finite()) {
            return Err(Error::new(Cause::Fit, "the loss is no longer finite").hint(
                "lower `train.learning_rate`, set `train.clip`, or give the fit a `ridge`; \
                 training goes on from the last checkpoint",
            ));
        }
        let gradients = GradientsParams::from_grads(losses.total.backward(), &self.net);
        self.net = self.optimiser.step(rate, self.net, gradients);
        self.average = self
            .average
            .map(|(average, decay)| (follow(average, &self.net, decay, number), decay));
        Ok((self, step))
    }
}
