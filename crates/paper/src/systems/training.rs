//! Training of systems.

use super::{
    Predictor, System as _, SystemConfig, SystemInput, SystemNet, SystemWeights, initial_net,
};
use burn::module::Module as _;
use lsdc_eval::data::{Mixture, write_atomically};
use lsdc_eval::predict::DepthCompleter;
use lsdc_files::error::{Error, Result};
use lsdc_train::device::Device;
use lsdc_train::sample::Batch;
use lsdc_train::training::{
    BackboneTraining, Learner, LossConfig, Losses, Objective, Subject, TrainConfig, TrainedPart,
    Trainer, TrainingRecord, depth_losses,
};
use lsdc_weights::{Precision, SCORES_NOTE, TRAINING_NOTE};
use serde_json::{Value, json};
use std::path::Path;

/// Prepares the run of a system in `folder`, which must exist.
///
/// # Errors
/// The errors of [`Trainer::new`], or settings that only apply to basis functions.
pub fn trainer(
    folder: &Path,
    system: SystemConfig,
    config: TrainConfig,
    frames: impl Into<Mixture>,
    devices: &[Device],
) -> Result<Trainer<SystemConfig>> {
    system.check()?;
    check(&system, &config)?;
    Trainer::of(
        folder,
        |input| system.normalisation(input),
        |_| Ok(system.clone()),
        config,
        frames,
        devices,
    )
}

/// Checks that all settings apply to systems.
fn check(system: &SystemConfig, config: &TrainConfig) -> Result<()> {
    let alien = [
        ("calibrate", config.calibrate),
        ("part", config.part != TrainedPart::All),
        ("start", config.start.is_some()),
        ("backbone", config.backbone != BackboneTraining::default()),
        ("features", config.features.is_some()),
        ("robust", config.robust.is_some()),
        ("loss.affinities", config.loss.affinities > 0.0),
        ("loss.mean", config.loss.mean > 0.0),
        ("loss.regularisation", config.loss.regularisation > 0.0),
        (
            "loss.teacher_affinities or teacher_span",
            config.loss.compares_networks(),
        ),
    ];
    let Some((name, _)) = alien.iter().find(|(_, given)| *given) else {
        return Ok(());
    };
    Err(Error::config(format!(
        "`train.{name}` is for basis functions, which {} does not have",
        system.kind().name()
    ))
    .hint("leave it out; `calibrate` must be false, and numbers 0"))
}

/// Training of a system by comparing its depths with the target depths.
pub struct DepthObjective {
    loss: LossConfig,
}

impl Objective<SystemNet> for DepthObjective {
    fn losses(&self, net: &SystemNet, batch: &Batch) -> Result<Losses> {
        let output = net.predict(&SystemInput::of(batch));
        // The unrefined output of a system with several parts has a loss as well.
        Ok(depth_losses(
            output.depth,
            output.unrefined,
            batch,
            &self.loss,
        ))
    }
}

impl Subject for SystemConfig {
    type Net = SystemNet;
    type Objective = DepthObjective;

    fn settings(&self) -> Value {
        json!({ "system": self })
    }

    fn start(&self, run: &Trainer<Self>, device: &Device) -> Result<SystemNet> {
        let seed = run.config().seed;
        if run.is_new() {
            initial_net(self, seed, device)
        } else {
            self.init(seed, device)
        }
    }

    fn learner(
        &self,
        run: &Trainer<Self>,
        device: &Device,
    ) -> Result<Learner<SystemNet, DepthObjective>> {
        let config = run.config();
        let objective = DepthObjective { loss: config.loss };
        Ok(Learner::with(self.start(run, device)?, objective, config))
    }

    fn completes(&self, run: &Trainer<Self>, net: &SystemNet) -> Result<Box<dyn DepthCompleter>> {
        let empty = SystemWeights::empty(self.clone(), run.normalisation());
        Ok(Box::new(Predictor::with(empty, net.valid(), run.device())))
    }

    fn publish(&self, run: &Trainer<Self>, net: &SystemNet, record: TrainingRecord) -> Result<()> {
        let mut trained = SystemWeights::of(&net.valid(), self.clone(), run.normalisation());
        record.add_to(&mut trained.notes, run.folder())?;
        trained.notes.insert(TRAINING_NOTE.to_owned(), run.note()?);
        if let Some(scores) = run.scores_note(|| self.completes(run, net))? {
            trained.notes.insert(SCORES_NOTE.to_owned(), scores);
        }
        let bytes = trained.to_bytes(Precision::Half)?;
        write_atomically(&run.weights_path(), |out| out.write_all(&bytes))
    }
}
