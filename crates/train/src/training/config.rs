//! Settings of a training run.

use super::{DistillTarget, LossConfig, Scenes, Schedule, TeacherConfig};
use crate::ops::Reweighting;
use crate::sample::{AugmentConfig, SupervisionConfig};
use lsdc_eval::data::Dataset;
use lsdc_eval::sampling::Protocol;
use lsdc_files::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Part of a network that is trained.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TrainedPart {
    /// The whole network, through the fit.
    #[default]
    All,
    /// The affinity network, through a field without basis functions; the rest is frozen.
    #[serde(alias = "edges")]
    Affinities,
    /// The basis functions, through the fit; the affinity network is frozen.
    Bases,
    /// The depth map predicted by a pretrained backbone, without fits; the rest is frozen.
    Map,
}

/// Optimiser of a training run.
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

/// Unit of held-out data.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum HeldOutUnit {
    /// Frames, even if training uses other frames of their scenes, as in versions without scenes.
    Frames,
    /// Whole scenes, if they are known ([`Scenes`]).
    #[default]
    Scenes,
}

/// Settings of training; the defaults are the paper's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainConfig {
    /// Number of optimiser steps.
    pub steps: usize,
    /// Number of images per step.
    pub batch: usize,
    /// Optimiser.
    pub optimiser: OptimiserKind,
    /// Peak learning rate.
    pub learning_rate: f64,
    /// L2 penalty added to the gradient, in Adam and SGD.
    pub weight_decay: f32,
    /// Largest gradient norm per tensor, in Adam and SGD; no limit if absent.
    pub clip: Option<f32>,
    /// Schedule of the learning rate.
    pub schedule: Schedule,
    /// Decay of the running average of the network per step; the average is evaluated and written. Absent: the network itself.
    pub average: Option<f64>,
    /// Fraction of the steps after which batch normalisation freezes its running statistics; 1 = never.
    pub freeze_statistics: f64,
    /// Seed of the run: weights, order, augmentation, points.
    pub seed: u64,
    /// Number of threads that prepare batches.
    pub workers: usize,
    /// Number of steps between checkpoints.
    pub save_every: usize,
    /// Number of steps between evaluations on held-out frames.
    pub measure_every: usize,
    /// Number of held-out frames to evaluate.
    pub held_out: usize,
    /// Unit of held-out data: "scenes", of which no frame is trained on, or "frames".
    pub held_out_by: HeldOutUnit,
    /// List of the scenes of all frames, with FRAME,SCENE in each line; if absent, the scene is the first folder in which the
    /// names of frames differ.
    pub scenes: Option<PathBuf>,
    /// Whether the prior over weights is learned after the last step, from training frames, with its noise from held-out
    /// frames; completion then uses it (see `fit.prior`).
    pub calibrate: bool,
    /// Part of the network that is trained.
    pub part: TrainedPart,
    /// Weights to start from: tensors that agree in name and shape are copied.
    pub start: Option<PathBuf>,
    /// Training of the stages of a pretrained network, for networks that have them (`network.extractor.backbone`).
    pub backbone: BackboneTraining,
    /// Teacher that predicts depth at pixels without measurements; if absent, only measured depths are used.
    pub teacher: Option<TeacherConfig>,
    /// Protocol that determines the training size.
    pub protocol: Protocol,
    /// Random augmentation of the frames.
    pub augment: AugmentConfig,
    /// Number of different augmented views of each frame; 0: a new one in every pass.
    pub views: usize,
    /// Folder of cached features of a pretrained encoder, for networks trained on one; if absent, they are computed in every
    /// step.
    pub features: Option<PathBuf>,
    /// Points and patches.
    pub supervision: SupervisionConfig,
    /// Robust fits in training; least squares if absent.
    pub robust: Option<Reweighting>,
    /// Weights of the losses.
    pub loss: LossConfig,
}

/// Settings for training the stages of a pretrained network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BackboneTraining {
    /// File of `EfficientNet`-Lite0 as published for `PyTorch`, to initialise the tensors that `start` does not have; random if
    /// absent.
    pub pretrained: Option<PathBuf>,
    /// Factor on the learning rate of these tensors, in Adam.
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
    /// Returns the teacher, if its depths are training targets.
    pub(super) fn depth_teacher(&self) -> Option<&TeacherConfig> {
        let teacher = self.teacher.as_ref();
        teacher.filter(|teacher| teacher.target != DistillTarget::Measured)
    }

    /// Returns the training frames and the held-out frames, by [`Scenes::divide`].
    ///
    /// # Errors
    /// The list of scenes is invalid.
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
