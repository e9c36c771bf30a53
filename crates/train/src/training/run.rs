//! A training run: its folder, its loop, and stopping and resuming it.

use super::checkpoint::Checkpoints;
use super::learner::Objective;
use super::log::{Log, TrainingEvent};
use super::record::TrainingRecord;
use super::setup::{batch_protocol, input_size, sampler};
use super::step::UnreadLosses;
use super::{Learner, TrainConfig};
use crate::device::{Device, is_gpu};
use crate::sample::{Batch, Loader, Sample, Sampler};
use burn::module::Module;
use lsdc_core::weights::Normalisation;
use lsdc_eval::data::{Dataset, Mixture, Shard, frames_record};
use lsdc_eval::predict::DepthCompleter;
use lsdc_files::error::{Error, Result};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Number of steps whose losses are read together from a GPU.
const READ_TOGETHER: usize = 20;

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RunOutcome {
    /// All steps are complete; `weights.safetensors` is written.
    Finished,
    /// Stopped on request after this many steps; a checkpoint is written.
    Stopped(usize),
}

/// The subject of a run, apart from its frames and settings.
pub trait Subject: Sized {
    /// The network.
    type Net: Module;
    /// The training objective.
    type Objective: Objective<Self::Net>;

    /// Returns its settings, for the record in the weights file.
    fn settings(&self) -> Value;

    /// Returns the network before the first step.
    ///
    /// # Errors
    /// A file of weights cannot be read, or does not match the network.
    fn start(&self, run: &Trainer<Self>, device: &Device) -> Result<Self::Net>;

    /// Returns the network with its optimiser, on an autodiff device.
    ///
    /// # Errors
    /// The errors of [`start`](Self::start).
    fn learner(&self, run: &Trainer<Self>, device: &Device) -> Result<LearnerOf<Self>>;

    /// Returns a completer that uses the current network.
    ///
    /// # Errors
    /// The network cannot be used.
    fn completes(&self, run: &Trainer<Self>, net: &Self::Net) -> Result<Box<dyn DepthCompleter>>;

    /// Writes [`weights_path`](Trainer::weights_path) after the last step.
    ///
    /// # Errors
    /// A file cannot be written.
    fn publish(&self, run: &Trainer<Self>, net: &Self::Net, record: TrainingRecord) -> Result<()>;
}

/// The learner of a subject.
type LearnerOf<S> = Learner<<S as Subject>::Net, <S as Subject>::Objective>;

/// Training of a network in a run folder.
pub struct Trainer<S> {
    pub(super) folder: PathBuf,
    pub(super) subject: S,
    pub(super) config: TrainConfig,
    /// Frames for evaluation and calibration.
    pub(super) frames: Arc<dyn Dataset>,
    /// Description of all training frames, which changes with their names.
    pub(super) data: Value,
    /// Sampler of the training frames.
    pub(super) sampler: Sampler,
    /// Indices of the held-out frames.
    pub(super) held_out: Vec<usize>,
    pub(super) normalisation: Normalisation,
    /// At least one device.
    pub(super) devices: Vec<Device>,
}

impl<S: Subject> Trainer<S> {
    /// Prepares a run. `normalisation` is a function of the height and width of images, and the subject is created from its
    /// result.
    ///
    /// # Errors
    /// The errors of [`Trainer::new`], or those of the subject.
    pub fn of(
        folder: &Path,
        normalisation: impl FnOnce([usize; 2]) -> Normalisation,
        subject: impl FnOnce(&Normalisation) -> Result<S>,
        config: TrainConfig,
        frames: impl Into<Mixture>,
        devices: &[Device],
    ) -> Result<Self> {
        let mixture = frames.into();
        check(&config, &mixture, devices)?;
        let frames = mixture.first().clone();
        let config = TrainConfig {
            protocol: batch_protocol(&config.protocol, frames.as_ref())?,
            ..config
        };
        let normalisation = normalisation(input_size(&config.protocol, frames.as_ref())?);
        let (_, held_out) = config.divide(frames.as_ref())?;
        Ok(Self {
            folder: folder.to_owned(),
            subject: subject(&normalisation)?,
            data: frames_record(&mixture),
            sampler: sampler(mixture, &config)?,
            held_out,
            normalisation,
            config,
            frames,
            devices: devices.to_vec(),
        })
    }

    /// Computes the cached files of the frames of a shard: the predictions of the teacher, and the features of their views.
    /// Returns whether all were computed before `stop` was set; calls `progress` with the numbers of frames done and in total.
    ///
    /// # Errors
    /// The settings cache nothing, frames cannot be read, or files cannot be written.
    pub fn prepare(
        &self,
        shard: Shard,
        stop: &AtomicBool,
        progress: impl Fn(usize, usize),
    ) -> Result<bool> {
        let config = &self.config;
        let features = self.sampler.is_encoded() && config.features.is_some() && config.views > 0;
        let predictions = config
            .depth_teacher()
            .is_some_and(|teacher| teacher.folder.is_some());
        if !features && !predictions {
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

    /// Trains from the last checkpoint of the folder, or from the start, until all steps are complete or `stop` is set. A seed
    /// gives identical results, also after interruptions.
    ///
    /// # Errors
    /// Frames cannot be read, the folder cannot be written, or a loss is not finite.
    pub fn run(&self, stop: &AtomicBool, report: impl FnMut(&TrainingEvent)) -> Result<RunOutcome> {
        let device = self.device().clone().autodiff();
        // Collected before the first step: files that it names may be deleted during the run.
        let record = self.record(self.subject.settings())?;
        let learner = self.subject.learner(self, &device)?;
        let (learner, outcome) = self.take_steps(learner, stop, report)?;
        if outcome == RunOutcome::Finished {
            self.subject.publish(self, learner.net(), record)?;
        }
        Ok(outcome)
    }

    /// Runs the remaining steps.
    fn take_steps(
        &self,
        mut learner: Learner<S::Net, S::Objective>,
        stop: &AtomicBool,
        mut report: impl FnMut(&TrainingEvent),
    ) -> Result<(LearnerOf<S>, RunOutcome)> {
        let checkpoints = Checkpoints::new(&self.folder);
        let mut step = 0;
        if let Some(&last) = checkpoints.steps().last() {
            learner = checkpoints.load(last, learner)?;
            step = last;
        }
        let mut log = Log::open(&self.folder, step)?;
        let mut log_event = |event: TrainingEvent| -> Result<()> {
            report(&event);
            log.add(&event)
        };
        let held_out = &self.held_out;
        let mut loader = Loader::start(&self.sampler, step, self.config.workers)?;
        // A GPU computes while the next steps are launched; elsewhere every step is complete when it returns.
        let together = if self.devices.iter().any(is_gpu) {
            READ_TOGETHER
        } else {
            1
        };
        let mut unread = Vec::new();
        let mut started = Instant::now();
        while step < self.config.steps {
            if unread.is_empty() {
                started = Instant::now();
            }
            let samples = loader.next_batch()?;
            let shares = self.divided(&samples)?;
            let rate = self.rate(step);
            if step as f64 >= self.config.freeze_statistics * self.config.steps as f64 {
                learner = learner.freeze_statistics();
            }
            let (next, losses) = learner.step_unread(&shares, rate, step + 1)?;
            learner = next;
            step += 1;
            unread.push((step, rate, losses));
            let last = step == self.config.steps;
            let measuring =
                !held_out.is_empty() && (step.is_multiple_of(self.config.measure_every) || last);
            let saving = step.is_multiple_of(self.config.save_every) || last;
            if unread.len() == together || measuring || saving {
                for event in read(std::mem::take(&mut unread), started)? {
                    log_event(event)?;
                }
            }
            if measuring {
                let held_out = self.measure(&*self.subject.completes(self, learner.net())?)?;
                log_event(TrainingEvent::Measured { step, held_out })?;
            }
            let stopping = stop.load(Ordering::Relaxed);
            if saving || stopping {
                // No checkpoint has losses that are not finite.
                for event in read(std::mem::take(&mut unread), started)? {
                    log_event(event)?;
                }
                checkpoints.save(step, &learner)?;
            }
            if stopping && !last {
                return Ok((learner, RunOutcome::Stopped(step)));
            }
        }
        Ok((learner, RunOutcome::Finished))
    }

    /// Returns the folder of the run.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Returns the settings.
    pub fn config(&self) -> &TrainConfig {
        &self.config
    }

    /// Returns the normalisation of images, with their size.
    pub fn normalisation(&self) -> Normalisation {
        self.normalisation
    }

    /// Returns the device for evaluation and calibration.
    pub fn device(&self) -> &Device {
        &self.devices[0]
    }

    /// Returns whether no checkpoint was written yet.
    pub fn is_new(&self) -> bool {
        Checkpoints::new(&self.folder).steps().is_empty()
    }

    /// Divides a batch among the devices as evenly as possible.
    fn divided(&self, samples: &[Sample]) -> Result<Vec<Batch>> {
        let count = self.devices.len();
        let bound = |i: usize| i * samples.len() / count;
        let devices = self.devices.iter().enumerate();
        devices
            .map(|(i, device)| {
                let share = &samples[bound(i)..bound(i + 1)];
                Batch::new(share, self.normalisation, &device.clone().autodiff())
            })
            .collect()
    }

    /// Checks that all files that a new run starts from can be read.
    ///
    /// # Errors
    /// A file of weights cannot be read, or does not match the network.
    pub fn check_start(&self) -> Result<()> {
        self.subject.start(self, self.device()).map(drop)
    }

    fn rate(&self, step: usize) -> f64 {
        let progress = (step + 1) as f64 / self.config.steps as f64;
        self.config.learning_rate * self.config.schedule.factor(progress)
    }
}

/// Reads steps with their numbers and learning rates, which began at this time.
fn read(
    steps: Vec<(usize, f64, UnreadLosses)>,
    started: Instant,
) -> Result<impl Iterator<Item = TrainingEvent>> {
    let (numbers, losses): (Vec<_>, Vec<_>) = steps
        .into_iter()
        .map(|(step, rate, losses)| ((step, rate), losses))
        .unzip();
    let losses = UnreadLosses::read(losses)?;
    let seconds = started.elapsed().as_secs_f64() / numbers.len() as f64;
    let steps = numbers.into_iter().zip(losses);
    Ok(steps.map(move |((step, rate), made)| TrainingEvent::Step {
        step,
        loss: made.loss,
        l1: made.l1,
        rmse: made.l2.sqrt(),
        rate,
        seconds,
    }))
}

/// Checks the settings common to all runs.
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
    if !mixture.has_depth() && config.depth_teacher().is_none() {
        return Err(Error::config(
            "images without depths teach nothing without a teacher's depths",
        )
        .hint("set `train.teacher`, its `target` to \"images\", \"fill\" or \"all\", or `data.folder.depth`"));
    }
    if !mixture.first().has_depth() && (config.held_out > 0 || config.calibrate) {
        return Err(
            Error::config("the first dataset has no depths to measure and calibrate on")
                .hint("name one with depths first, and images alone in `data.more`"),
        );
    }
    Ok(())
}
