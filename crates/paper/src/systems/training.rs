//! Systems as the subject of a training run.

use super::{Net, Predictor, System as _, SystemConfig, SystemInput, Trained, begin};
use burn::module::Module as _;
use lsdc_eval::data::{Mixture, write_atomically};
use lsdc_eval::predict::Completes;
use lsdc_files::error::{Error, Result};
use lsdc_train::device::Device;
use lsdc_train::sample::Batch;
use lsdc_train::training::{
    BackboneTraining, Learner, LossConfig, Losses, Objective, Part, Record, Subject, TrainConfig,
    Trainer, depth_losses,
};
use lsdc_weights::{Precision, SCORES_NOTE, TRAINING_NOTE};
use serde_json::{Value, json};
use std::path::Path;

/// Prepares the run of a system in `folder`, which must exist.
///
/// # Errors
/// As [`Trainer::new`], and settings that only basis functions have.
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

/// Whether all settings are of systems.
fn check(system: &SystemConfig, config: &TrainConfig) -> Result<()> {
    let alien = [
        ("calibrate", config.calibrate),
        ("part", config.part != Part::All),
        ("start", config.start.is_some()),
        ("backbone", config.backbone != BackboneTraining::default()),
        ("features", config.features.is_some()),
        ("robust", config.robust.is_some()),
        ("loss.affinities", config.loss.affinities > 0.0),
        ("loss.mean", config.loss.mean > 0.0),
        ("loss.regularisation", config.loss.regularisation > 0.0),
        (
            "loss.teacher_affinities or teacher_span",
            config.loss.imitates(),
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

/// Depths near those that are to be found.
pub struct Predicting {
    loss: LossConfig,
}

impl Objective<Net> for Predicting {
    fn losses(&self, net: &Net, batch: &Batch) -> Result<Losses> {
        let said = net.predict(&SystemInput::of(batch));
        // A system of several parts learns from what the first of them say too.
        Ok(depth_losses(said.depth, said.before, batch, &self.loss))
    }
}

impl Subject for SystemConfig {
    type Net = Net;
    type Objective = Predicting;

    fn settings(&self) -> Value {
        json!({ "system": self })
    }

    fn start(&self, run: &Trainer<Self>, device: &Device) -> Result<Net> {
        let seed = run.config().seed;
        if run.is_new() {
            begin(self, seed, device)
        } else {
            self.init(seed, device)
        }
    }

    fn learner(&self, run: &Trainer<Self>, device: &Device) -> Result<Learner<Net, Predicting>> {
        let config = run.config();
        let objective = Predicting { loss: config.loss };
        Ok(Learner::with(self.start(run, device)?, objective, config))
    }

    fn completes(&self, run: &Trainer<Self>, net: &Net) -> Result<Box<dyn Completes>> {
        let empty = Trained::empty(self.clone(), run.normalisation());
        Ok(Box::new(Predictor::with(empty, net.valid(), run.device())))
    }

    fn publish(&self, run: &Trainer<Self>, net: &Net, record: Record) -> Result<()> {
        let mut trained = Trained::of(&net.valid(), self.clone(), run.normalisation());
        record.keep(&mut trained.notes, run.folder())?;
        trained.notes.insert(TRAINING_NOTE.to_owned(), run.note()?);
        if let Some(scores) = run.scores_note(|| self.completes(run, net))? {
            trained.notes.insert(SCORES_NOTE.to_owned(), scores);
        }
        let bytes = trained.to_bytes(Precision::Half)?;
        write_atomically(&run.weights_path(), |out| out.write_all(&bytes))
    }
}
