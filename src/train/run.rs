//! A training run: its folder, its loop, stopping and going on.

use super::checkpoint::Checkpoints;
use super::learner::Objective;
use super::log::Log;
use super::setup::{check_network, imitated, input_size, sampler, start_adapters, with_backbone};
use super::{BackboneTraining, Learner, Part, TrainConfig};
use crate::data::{Dataset, Mixture, Shard};
use crate::error::{Error, Result};
use crate::metrics::Scores;
use crate::model::{BasisNet, InitNetwork as _, NetworkConfig, Normalisation, load, transfer};
use crate::predict::{adapted_blocks, encoder_of, first_adapted, open_weights};
use crate::provenance;
use crate::sample::{Batch, Encoding, Loader, Sample, Sampler};
use crate::systems::{Net, Predictor, SystemConfig, Trained, begin};
use burn::module::Module;
use burn::tensor::Device;
use lsdc_core::Weights;
use lsdc_core::fit::FitConfig;
use lsdc_core::network::Encoder;
use serde::Serialize;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// What happens during a run; also the lines of `metrics.jsonl`.
#[derive(Clone, Copy, Debug, Serialize)]
#[serde(rename_all = "lowercase", untagged)]
pub enum Event {
    /// A step was made.
    Step {
        /// Steps so far.
        step: usize,
        /// The weighted sum of the losses.
        loss: f64,
        /// Mean absolute error in metres.
        l1: f64,
        /// Root of the mean squared error in metres, over the batch.
        rmse: f64,
        /// The learning rate.
        rate: f64,
        /// Duration of the step.
        seconds: f64,
    },
    /// The frames kept out of training were completed from 500 points.
    Measured {
        /// Steps so far.
        step: usize,
        /// Mean scores.
        held_out: Scores,
    },
}

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// All steps were made; `weights.safetensors` is written.
    Finished,
    /// Stopped on request after this many steps; a checkpoint is written.
    Stopped(usize),
}

/// Trains a network in a run folder.
pub struct Trainer {
    pub(super) folder: PathBuf,
    subject: Subject,
    pub(super) config: TrainConfig,
    /// What the network is measured and calibrated on.
    pub(super) frames: Arc<dyn Dataset>,
    /// All frames that are learned from, in words that change with their names.
    pub(super) data: Value,
    /// The frames that are learned from, and what is drawn of them.
    sampler: Sampler,
    /// Frames that are kept out of training.
    pub(super) held_out: Vec<usize>,
    pub(super) normalisation: Normalisation,
    /// At least one.
    pub(super) devices: Vec<Device>,
}

/// What is trained.
enum Subject {
    /// Basis functions.
    Bases(Box<Bases>),
    /// A system that the paper compares itself with.
    System(Box<SystemConfig>),
}

/// Basis functions, and what belongs to them.
pub(super) struct Bases {
    pub(super) network: NetworkConfig,
    pub(super) fit: FitConfig,
    /// The weights of a teacher whose network is compared with.
    imitated: Option<Weights>,
    /// What the network reads beside the image, if it was made for that.
    pub(super) encoder: Option<Arc<Encoder>>,
}

impl Trainer {
    /// Prepares a run in `folder`, which must exist. Several devices divide every batch among them;
    /// the first measures and calibrates.
    ///
    /// # Errors
    /// A setting out of range, no device or more than images in a batch, or no frame that can be
    /// read.
    pub fn new(
        folder: &Path,
        network: NetworkConfig,
        fit: FitConfig,
        config: TrainConfig,
        frames: impl Into<Mixture>,
        devices: &[Device],
    ) -> Result<Self> {
        let mixture = frames.into();
        network.check()?;
        check_network(&network, &config)?;
        fit.check()?;
        check(&config, &mixture, devices)?;
        let frames = mixture.first().clone();
        let encoder = encoder_of(&network)?;
        let normalisation = Normalisation {
            input: input_size(&config.protocol, frames.as_ref())?,
            ..Normalisation::default()
        };
        let (_, held_out) = config.divide(frames.as_ref())?;
        let imitated = imitated(&config, &normalisation)?;
        let encoding = match (&encoder, &imitated) {
            (None, Some(weights)) => encoder_of(&weights.network)?,
            _ => encoder.clone(),
        }
        .map(|encoder| {
            let encoding = Encoding::new(encoder, normalisation, config.features.clone());
            encoding.entering(first_adapted(&network))
        });
        Ok(Self {
            folder: folder.to_owned(),
            data: provenance::frames(&mixture),
            sampler: sampler(mixture, &config)?.encoded(encoding),
            held_out,
            subject: Subject::Bases(Box::new(Bases {
                network,
                fit,
                imitated,
                encoder,
            })),
            normalisation,
            config,
            frames,
            devices: devices.to_vec(),
        })
    }

    /// Prepares the run of a system in the same way.
    ///
    /// # Errors
    /// As [`Trainer::new`], and settings that only basis functions have.
    pub fn of_system(
        folder: &Path,
        system: SystemConfig,
        config: TrainConfig,
        frames: impl Into<Mixture>,
        devices: &[Device],
    ) -> Result<Self> {
        let mixture = frames.into();
        system.check()?;
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
        if let Some((name, _)) = alien.iter().find(|(_, given)| *given) {
            return Err(Error::config(format!(
                "`train.{name}` is for basis functions, which {} does not have",
                system.kind().name()
            ))
            .hint("leave it out; `calibrate` must be false, and numbers 0"));
        }
        check(&config, &mixture, devices)?;
        let frames = mixture.first().clone();
        let input = input_size(&config.protocol, frames.as_ref())?;
        let (_, held_out) = config.divide(frames.as_ref())?;
        Ok(Self {
            folder: folder.to_owned(),
            data: provenance::frames(&mixture),
            sampler: sampler(mixture, &config)?,
            held_out,
            normalisation: system.normalisation(input),
            subject: Subject::System(Box::new(system)),
            config,
            frames,
            devices: devices.to_vec(),
        })
    }

    /// Computes what the run keeps in files of the frames of a shard: the answers of its teacher, and what its
    /// encoder says of their views. Returns whether all was done before `stop` was set; calls `progress` with the
    /// number of frames done and of all.
    ///
    /// # Errors
    /// Settings by which nothing is kept, frames that cannot be read, or files that cannot be written.
    pub fn prepare(
        &self,
        shard: Shard,
        stop: &AtomicBool,
        progress: impl Fn(usize, usize),
    ) -> Result<bool> {
        let config = &self.config;
        let features = self.sampler.is_encoded() && config.features.is_some() && config.views > 0;
        let answers = config
            .completing()
            .is_some_and(|teacher| teacher.folder.is_some());
        if !features && !answers {
            return Err(Error::config("by these settings, nothing is kept in files").hint(
                "set `train.teacher.folder`, or for networks with an encoder `train.features` and `train.views`",
            ));
        }
        let frames = self.sampler.frames(shard);
        for (done, &index) in frames.iter().enumerate() {
            if stop.load(Ordering::Relaxed) {
                return Ok(false);
            }
            self.sampler.prepare(index)?;
            progress(done + 1, frames.len());
        }
        Ok(true)
    }

    /// Trains from the last checkpoint of the folder, or from the start, until all steps are made
    /// or `stop` is set. The same seed gives the same bits, interrupted or not.
    ///
    /// # Errors
    /// Unreadable frames, an unwritable folder, or a loss that is not finite.
    pub fn run(&self, stop: &AtomicBool, report: impl FnMut(&Event)) -> Result<Outcome> {
        let device = self.device().clone().autodiff();
        match &self.subject {
            Subject::Bases(bases) => {
                let record = self.record(json!({
                    "network": bases.network,
                    "fit": bases.fit,
                }))?;
                let (net, new) = self.initial(bases, &device)?;
                if self.config.start.is_some() {
                    tracing::info!(
                        "{new} tensors are not those of the start weights: they begin at random, or with the backbone's"
                    );
                }
                let teacher = bases.imitated.as_ref();
                let teacher = teacher.map(|weights| load(weights, self.device()));
                let learner = Learner::new(net, &bases.fit, &self.config);
                let learner = learner
                    .taught_by(teacher.transpose()?)
                    .adapting(adapted_blocks(&bases.network, &device)?);
                let measure = |net: &BasisNet| self.measure(&self.completer(bases, net)?);
                let (learner, outcome) = self.go_on(learner, measure, stop, report)?;
                if outcome == Outcome::Finished {
                    self.publish(bases, learner.net(), record)?;
                }
                Ok(outcome)
            }
            Subject::System(system) => {
                let record = self.record(json!({ "system": system }))?;
                let fresh = Checkpoints::new(&self.folder).steps().is_empty();
                let net = if fresh {
                    begin(system, self.config.seed, &device)?
                } else {
                    system.init(self.config.seed, &device)?
                };
                let learner = Learner::of_system(net, &self.config);
                let measure = |net: &Net| {
                    let empty = Trained::empty(*system.clone(), self.normalisation);
                    self.measure(&Predictor::with(empty, net.valid(), self.device()))
                };
                let (learner, outcome) = self.go_on(learner, measure, stop, report)?;
                if outcome == Outcome::Finished {
                    self.publish_system(system, learner.net(), measure, record)?;
                }
                Ok(outcome)
            }
        }
    }

    /// All steps that are left.
    fn go_on<M: Module, O: Objective<M>>(
        &self,
        mut learner: Learner<M, O>,
        measure: impl Fn(&M) -> Result<Scores>,
        stop: &AtomicBool,
        mut report: impl FnMut(&Event),
    ) -> Result<(Learner<M, O>, Outcome)> {
        let checkpoints = Checkpoints::new(&self.folder);
        let mut step = 0;
        if let Some(&last) = checkpoints.steps().last() {
            learner = checkpoints.load(last, learner)?;
            step = last;
        }
        let mut log = Log::open(&self.folder, step)?;
        let mut tell = |event: Event| -> Result<()> {
            report(&event);
            log.add(&event)
        };
        let held_out = &self.held_out;
        let mut loader = Loader::start(&self.sampler, step, self.config.workers)?;
        while step < self.config.steps {
            let started = Instant::now();
            let samples = loader.next_batch()?;
            let shares = self.divided(&samples)?;
            let rate = self.rate(step);
            if step as f64 >= self.config.freeze_statistics * self.config.steps as f64 {
                learner = learner.freeze_statistics();
            }
            let (next, made) = learner.step(&shares, rate, step + 1)?;
            learner = next;
            step += 1;
            tell(Event::Step {
                step,
                loss: made.loss,
                l1: made.l1,
                rmse: made.l2.sqrt(),
                rate,
                seconds: started.elapsed().as_secs_f64(),
            })?;
            let last = step == self.config.steps;
            if !held_out.is_empty() && (step.is_multiple_of(self.config.measure_every) || last) {
                let held_out = measure(learner.net())?;
                tell(Event::Measured { step, held_out })?;
            }
            let stopping = stop.load(Ordering::Relaxed);
            if step.is_multiple_of(self.config.save_every) || last || stopping {
                checkpoints.save(step, &learner)?;
            }
            if stopping && !last {
                return Ok((learner, Outcome::Stopped(step)));
            }
        }
        Ok((learner, Outcome::Finished))
    }

    /// The device that measures and calibrates.
    pub(super) fn device(&self) -> &Device {
        &self.devices[0]
    }

    /// A batch, divided among the devices as evenly as can be.
    fn divided(&self, samples: &[Sample]) -> Result<Vec<Batch>> {
        let Normalisation {
            mean, deviation, ..
        } = self.normalisation;
        let count = self.devices.len();
        let bound = |i: usize| i * samples.len() / count;
        let devices = self.devices.iter().enumerate();
        devices
            .map(|(i, device)| {
                let share = &samples[bound(i)..bound(i + 1)];
                Batch::new(share, mean, deviation, &device.clone().autodiff())
            })
            .collect()
    }

    /// Whether all that a new run starts from can be read.
    ///
    /// # Errors
    /// A file of weights that cannot be read, or that does not fit the network.
    pub fn check_start(&self) -> Result<()> {
        match &self.subject {
            Subject::Bases(bases) => self.initial(bases, self.device()).map(drop),
            Subject::System(system) => begin(system, self.config.seed, self.device()).map(drop),
        }
    }

    /// The network before the first step, and how many of its tensors the start weights do not have.
    fn initial(&self, bases: &Bases, device: &Device) -> Result<(BasisNet, usize)> {
        let net = bases.network.init(self.config.seed, device)?;
        let net = with_backbone(net, &bases.network, &self.config.backbone)?;
        let Some(path) = &self.config.start else {
            return Ok((net, 0));
        };
        let start = open_weights(Some(path))?;
        start_adapters(&start.network, &bases.network)?;
        transfer(&start, net)
    }

    fn rate(&self, step: usize) -> f64 {
        let progress = (step + 1) as f64 / self.config.steps as f64;
        self.config.learning_rate * self.config.schedule.factor(progress)
    }
}

/// Checks what all runs have in common.
fn check(config: &TrainConfig, mixture: &Mixture, devices: &[Device]) -> Result<()> {
    config.check()?;
    if !(1..=config.batch).contains(&devices.len()) {
        return Err(Error::config(format!(
            "{} devices cannot divide a batch of {}",
            devices.len(),
            config.batch
        ))
        .hint("give one device at least, and at most `train.batch`"));
    }
    if !mixture.measured() && config.completing().is_none() {
        return Err(Error::config(
            "images without depths teach nothing without a teacher's depths",
        )
        .hint("set `train.teacher`, its `target` to \"images\", \"fill\" or \"all\", or `data.folder.depth`"));
    }
    if !mixture.first().measured() && (config.held_out > 0 || config.calibrate) {
        return Err(
            Error::config("the first dataset has no depths to measure and calibrate on")
                .hint("name one with depths first, and images alone in `data.more`"),
        );
    }
    Ok(())
}
