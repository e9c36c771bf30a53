//! Settings of a training run.

use super::{DistillTarget, LossConfig, Scenes, Schedule, TeacherConfig};
use crate::ops::Reweighting;
use crate::sample::{AugmentConfig, SupervisionConfig};
use lsdc_eval::data::Dataset;
use lsdc_eval::sampling::Protocol;
use lsdc_files::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// What of a network is trained.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TrainedPart {
    /// Everything, through the fit.
    #[default]
    All,
    /// The affinity network, through a field without basis functions; the others stay as they are.
    #[serde(alias = "edges")]
    Affinities,
    /// The basis functions, through the fit; the affinity network stays as it is.
    Bases,
    /// The map that a pretrained backbone suggests, without fits; the others stay as they are.
    Map,
}

/// What turns gradients into steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum OptimiserKind {
    /// Adam (Kingma and Ba 2015).
    #[default]
    Adam,
    /// Stochastic gradient descent with momentum 0.9.
    Sgd,
    /// Muon (Jordan et al. 2024) for the weights of layers, Adam for the rest.
    Muon,
}

/// What is held out of training as a whole.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum HeldOutUnit {
    /// Frames, though others of their scenes are learned from: as before scenes were known.
    Frames,
    /// Scenes, where they are known ([`Scenes`]).
    #[default]
    Scenes,
}

/// How to train; the defaults are the paper's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainConfig {
    /// Number of optimiser steps.
    pub steps: usize,
    /// Images per step.
    pub batch: usize,
    /// What turns gradients into steps.
    pub optimiser: OptimiserKind,
    /// Peak learning rate.
    pub learning_rate: f64,
    /// L2 penalty added to the gradient, in Adam and SGD.
    pub weight_decay: f32,
    /// Largest norm of the gradient of one tensor, in Adam and SGD; absent = not limited.
    pub clip: Option<f32>,
    /// The learning rate over time.
    pub schedule: Schedule,
    /// How much of the average of the network is kept in a step; the average is what is measured and
    /// written. Absent = the network as it is.
    pub average: Option<f64>,
    /// The share of steps after which batch normalisation keeps its running statistics; 1 = never.
    pub freeze_statistics: f64,
    /// The run's seed: weights, order, augmentation, points.
    pub seed: u64,
    /// Threads that prepare batches.
    pub workers: usize,
    /// Steps between checkpoints.
    pub save_every: usize,
    /// Steps between measurements on frames kept out of training.
    pub measure_every: usize,
    /// The number of frames kept out of training for that.
    pub held_out: usize,
    /// What these are taken from: "scenes", none of whose frames are learned from, or "frames".
    pub held_out_by: HeldOutUnit,
    /// A list of the scenes of all frames, FRAME,SCENE in each line; absent: the first folder in which the names of frames
    /// differ.
    pub scenes: Option<PathBuf>,
    /// Whether, after the last step, the prior over weights is learned from training frames and its
    /// noise from held-out ones, and completion uses it (see `fit.prior`).
    pub calibrate: bool,
    /// What is trained.
    pub part: TrainedPart,
    /// Weights to start from: tensors that agree in name and shape are taken.
    pub start: Option<PathBuf>,
    /// How the stages of a pretrained network are trained, for networks that have such (`network.extractor.backbone`).
    pub backbone: BackboneTraining,
    /// A network that predicts depth where none was measured; absent: only measured depths are learned.
    pub teacher: Option<TeacherConfig>,
    /// The size at which to train.
    pub protocol: Protocol,
    /// Random changes of the frames.
    pub augment: AugmentConfig,
    /// The number of different views of each frame that these make; 0: a new one in every pass.
    pub views: usize,
    /// The folder of cached features of a pretrained encoder, for networks trained on one; absent: they are
    /// computed in every step.
    pub features: Option<PathBuf>,
    /// Points and patches.
    pub supervision: SupervisionConfig,
    /// Fits that do not follow outliers, in training; absent = plain ones.
    pub robust: Option<Reweighting>,
    /// Weights of the losses.
    pub loss: LossConfig,
}

/// Training of the stages of a pretrained network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BackboneTraining {
    /// `EfficientNet`-Lite0 as published for `PyTorch`, whose tensors they begin with where `start` has none; absent:
    /// they begin at random.
    pub pretrained: Option<PathBuf>,
    /// Adam moves them with this share of the learning rate.
    pub rate: f64,
}

impl Default for BackboneTraining {
    fn default() -> Self {
        Self {
            pretrained: None,
            rate: 0.1,
        }
    }
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            // 100 epochs of 6000 frames in batches of 2.
            steps: 300_000,
            batch: 2,
            optimiser: OptimiserKind::Adam,
            learning_rate: 1e-4,
            weight_decay: 5e-4,
            clip: None,
            schedule: Schedule::default(),
            average: None,
            freeze_statistics: 1.0,
            seed: 0,
            workers: 2,
            save_every: 1000,
            measure_every: 1000,
            held_out: 24,
            held_out_by: HeldOutUnit::Scenes,
            scenes: None,
            calibrate: true,
            part: TrainedPart::All,
            start: None,
            backbone: BackboneTraining::default(),
            teacher: None,
            protocol: Protocol::nyu(),
            augment: AugmentConfig::default(),
            views: 0,
            features: None,
            supervision: SupervisionConfig::default(),
            robust: None,
            loss: LossConfig::default(),
        }
    }
}

impl TrainConfig {
    /// The teacher, if its depths are learned from.
    pub(super) fn depth_teacher(&self) -> Option<&TeacherConfig> {
        let teacher = self.teacher.as_ref();
        teacher.filter(|teacher| teacher.target != DistillTarget::Measured)
    }

    /// Frames to train on and frames to measure on, as [`Scenes::divide`].
    ///
    /// # Errors
    /// A list of scenes that cannot be used.
    pub fn divide(&self, frames: &dyn Dataset) -> Result<(Vec<usize>, Vec<usize>)> {
        let scenes = match self.held_out_by {
            HeldOutUnit::Frames => Scenes::unknown(frames),
            HeldOutUnit::Scenes => Scenes::of(frames, self.scenes.as_deref())?,
        };
        Ok(scenes.divide(frames, self.held_out))
    }

    /// Checks every setting.
    ///
    /// # Errors
    /// The first setting that is out of range.
    pub fn check(&self) -> Result<()> {
        let positive = [self.steps, self.batch, self.save_every, self.measure_every];
        if positive.contains(&0) {
            return Err(Error::config(
                "`train.steps`, `batch`, `save_every` and `measure_every` must be above 0",
            ));
        }
        let rate = self.learning_rate;
        if !(rate > 0.0 && rate.is_finite() && self.weight_decay >= 0.0) {
            return Err(Error::config(
                "`train.learning_rate` must be above 0 and `weight_decay` at least 0",
            ));
        }
        self.protocol.check()?;
        if !(self.backbone.rate >= 0.0 && self.backbone.rate.is_finite()) {
            return Err(Error::config("`train.backbone.rate` must be at least 0"));
        }
        if self
            .average
            .is_some_and(|decay| !(0.0..1.0).contains(&decay))
        {
            return Err(Error::config("`train.average` must be in [0, 1)"));
        }
        match &self.teacher {
            Some(teacher) => {
                teacher.check()?;
                if self.depth_teacher().is_none() && !self.loss.compares_networks() {
                    return Err(Error::config(
                        "`train.teacher.target = \"measured\"` needs `train.loss.teacher_affinities` or \
                         `teacher_span`, else nothing is learned from the teacher",
                    ));
                }
            }
            None if self.loss.compares_networks() => {
                return Err(Error::config(
                    "`train.loss.teacher_affinities` and `teacher_span` need `train.teacher`",
                ));
            }
            None => {}
        }
        if self.part == TrainedPart::Map && self.loss != LossConfig::of_map(self.loss.mean) {
            return Err(
                Error::config("`train.part = \"map\"` learns by `train.loss.mean` alone")
                    .hint("set the other losses to 0, or take `nyu-map.toml`"),
            );
        }
        self.augment.check()?;
        self.supervision.check()?;
        self.robust.as_ref().map_or(Ok(()), Reweighting::check)?;
        self.loss.check()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_protocol_is_checked() {
        let of = |protocol| TrainConfig {
            protocol,
            ..TrainConfig::default()
        };
        assert!(of(Protocol::nyu()).check().is_ok());
        let pixels = Some(50);
        let own = Protocol {
            pixels,
            ..Protocol::default()
        };
        assert!(of(own).check().is_ok());
        let ignored = Protocol {
            pixels,
            ..Protocol::nyu()
        };
        assert!(of(ignored).check().is_err());
    }
}
