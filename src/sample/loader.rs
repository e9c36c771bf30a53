//! Batches of samples in a fixed order, prepared ahead by worker threads.

use super::patches::Sample;
use super::{AugmentConfig, Protocol, SupervisionConfig};
use crate::data::Dataset;
use crate::error::{Cause, Error, Result};
use crate::rng::Rng;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};

/// What turns a frame into a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SamplerConfig {
    /// The size at which to train.
    pub protocol: Protocol,
    /// Random changes.
    pub augment: AugmentConfig,
    /// Points and patches.
    pub supervision: SupervisionConfig,
    /// Samples per batch.
    pub batch: usize,
    /// The run's seed.
    pub seed: u64,
}

/// Makes the batch of any step: a pure function of the step.
#[derive(Clone)]
pub struct Sampler {
    frames: Arc<dyn Dataset>,
    /// The frames of the dataset that take part.
    indices: Arc<[usize]>,
    config: SamplerConfig,
}

impl Sampler {
    /// Samples the given frames of a dataset.
    ///
    /// # Errors
    /// No frame, or a batch size of 0.
    pub fn new(
        frames: Arc<dyn Dataset>,
        indices: Vec<usize>,
        config: SamplerConfig,
    ) -> Result<Self> {
        if indices.is_empty() || config.batch == 0 {
            return Err(Error::config(
                "training needs at least one frame and a batch size above 0",
            ));
        }
        Ok(Self {
            frames,
            indices: indices.into(),
            config,
        })
    }

    /// The samples of a step: every frame comes once before any comes again.
    ///
    /// # Errors
    /// A frame cannot be read.
    pub fn batch(&self, step: usize) -> Result<Vec<Sample>> {
        let first = step * self.config.batch;
        (first..first + self.config.batch)
            .map(|position| {
                let pass = position / self.indices.len();
                let index = self.order(pass)[position % self.indices.len()];
                let frame = self.frames.load(index)?;
                let keys = ["sample", &frame.id, &pass.to_string()];
                let mut rng = Rng::stream(self.config.seed, &keys);
                let config = &self.config;
                let frame = config.augment.apply(&frame, &config.protocol, &mut rng)?;
                Ok(Sample::draw(&frame, &config.supervision, &mut rng))
            })
            .collect()
    }

    /// The order of all frames in a pass.
    fn order(&self, pass: usize) -> Vec<usize> {
        let mut order = self.indices.to_vec();
        let count = order.len();
        Rng::stream(self.config.seed, &["order", &pass.to_string()]).choose(&mut order, count);
        order
    }
}

/// Prepares batches ahead of their use. Worker `w` of `n` makes the steps `w, w + n, ...`, so
/// batches come in order and do not depend on the number of workers.
pub struct Loader {
    queues: Vec<Receiver<Result<Vec<Sample>>>>,
    next: usize,
}

impl Loader {
    /// Starts `workers` threads that prepare batches from step `start` on.
    ///
    /// # Errors
    /// A thread cannot be started.
    pub fn start(sampler: &Sampler, start: usize, workers: usize) -> Result<Self> {
        let workers = workers.max(1);
        let queues = (0..workers)
            .map(|worker| {
                let (sender, receiver) = sync_channel(1);
                let sampler = sampler.clone();
                let steps = (start + worker..).step_by(workers);
                std::thread::Builder::new()
                    .name(format!("loader-{worker}"))
                    .spawn(move || {
                        for step in steps {
                            // The receiver is gone when training ends.
                            if sender.send(sampler.batch(step)).is_err() {
                                return;
                            }
                        }
                    })
                    .map_err(|e| Error::new(Cause::Device, "cannot start a thread").because(e))?;
                Ok(receiver)
            })
            .collect::<Result<_>>()?;
        Ok(Self { queues, next: 0 })
    }

    /// The samples of the next step.
    ///
    /// # Errors
    /// A frame cannot be read.
    pub fn next_batch(&mut self) -> Result<Vec<Sample>> {
        let queue = &self.queues[self.next];
        self.next = (self.next + 1) % self.queues.len();
        queue
            .recv()
            .map_err(|e| Error::new(Cause::Device, "a loader thread has died").because(e))?
    }
}
