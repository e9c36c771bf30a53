//! Batches of samples in a fixed order, prepared ahead by worker threads.

use super::patches::Sample;
use super::{AugmentConfig, Encoding, Order, SupervisionConfig};
use lsdc_eval::data::{Dataset, Frame, Shard};
use lsdc_eval::sampling::Protocol;
use lsdc_files::error::{Cause, Error, Result};
use lsdc_rng::Rng;
use std::collections::HashMap;
use std::sync::mpsc::{Receiver, sync_channel};
use std::sync::{Arc, Mutex};

/// Settings for turning frames into samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SamplerConfig {
    /// Protocol that determines the training size.
    pub protocol: Protocol,
    /// Random augmentation.
    pub augment: AugmentConfig,
    /// Number of different augmented views of each frame; 0: a new one in every pass.
    pub views: usize,
    /// Points and patches.
    pub supervision: SupervisionConfig,
    /// Samples per batch.
    pub batch: usize,
    /// Seed of the run.
    pub seed: u64,
}

/// A sampler that computes the batch of any step, as a pure function of the step.
#[derive(Clone)]
pub struct Sampler {
    frames: Arc<dyn Dataset>,
    /// Frames of the dataset used in training, and their order.
    order: Order,
    config: SamplerConfig,
    encoding: Option<Encoding>,
    cache: Arc<FrameCache>,
}

impl Sampler {
    /// Creates a sampler of the given frames of a dataset.
    ///
    /// # Errors
    /// No frame, or a batch size of 0.
    pub fn new(
        frames: Arc<dyn Dataset>,
        order: impl Into<Order>,
        config: SamplerConfig,
    ) -> Result<Self> {
        let order = order.into();
        if order.epoch() == 0 || config.batch == 0 {
            return Err(Error::config(
                "training needs at least one frame and a batch size above 0",
            ));
        }
        Ok(Self {
            frames,
            order,
            config,
            encoding: None,
            cache: Arc::default(),
        })
    }

    /// Sets the encoding of the image of each sample.
    #[must_use]
    pub fn encoded(self, encoding: Option<Encoding>) -> Self {
        Self { encoding, ..self }
    }

    /// Returns the samples of a step.
    ///
    /// # Errors
    /// A frame cannot be read.
    pub fn batch(&self, step: usize) -> Result<Vec<Sample>> {
        let first = step * self.config.batch;
        (first..first + self.config.batch)
            .map(|position| {
                let (index, pass) = self.order.at(position, self.config.seed);
                let frame = self.scaled(index)?;
                let config = &self.config;
                let mut rng = self.stream("sample", &frame, pass);
                let frame = match config.views {
                    0 => config.augment.apply(&frame, &config.protocol, &mut rng)?,
                    views => self.view(&frame, pass % views)?,
                };
                let encoding = self.encoding.as_ref();
                Ok(Sample {
                    encoded: encoding.map(|e| e.of(&frame.rgb)).transpose()?,
                    ..Sample::draw(&frame, &config.supervision, &mut rng)?
                })
            })
            .collect()
    }

    /// Returns whether images are encoded.
    pub fn is_encoded(&self) -> bool {
        self.encoding.is_some()
    }

    /// Returns the training frames that belong to a shard.
    pub fn frames(&self, shard: Shard) -> Vec<usize> {
        let all = self.order.frames();
        all.filter(|&index| shard.holds(&self.frames.id(index)))
            .collect()
    }

    /// Computes the cached files of the frame at `index` of the dataset: the predictions of a teacher, and the features of its
    /// views.
    ///
    /// # Errors
    /// The frame cannot be read, or a file cannot be written.
    pub fn prepare(&self, index: usize) -> Result<()> {
        let frame = self.config.protocol.scale(&self.frames.load(index)?)?;
        let Some(encoding) = &self.encoding else {
            return Ok(());
        };
        (0..self.config.views).try_for_each(|view| {
            let view = self.view(&frame, view)?;
            encoding.of(&view.rgb).map(drop)
        })
    }

    /// Returns one of the views of a frame, if their number is limited.
    fn view(&self, frame: &Frame, view: usize) -> Result<Frame> {
        let mut rng = self.stream("view", frame, view);
        let SamplerConfig {
            augment, protocol, ..
        } = &self.config;
        augment.apply(frame, protocol, &mut rng)
    }

    fn stream(&self, what: &str, frame: &Frame, pass: usize) -> Rng {
        Rng::stream(self.config.seed, &[what, &frame.id, &pass.to_string()])
    }

    /// Returns a frame scaled by the protocol.
    fn scaled(&self, index: usize) -> Result<Arc<Frame>> {
        if let Some(frame) = self.cache.get(index) {
            return Ok(frame);
        }
        let frame = self.config.protocol.scale(&self.frames.load(index)?)?;
        // Not used in training.
        let (sparse, mask, rings) = (None, None, None);
        let frame = Arc::new(Frame {
            sparse,
            mask,
            rings,
            ..frame
        });
        self.cache.insert(index, &frame);
        Ok(frame)
    }
}

/// Frames in memory: decoding and scaling a frame takes longer than the random augmentation.
#[derive(Default)]
struct FrameCache(Mutex<(HashMap<usize, Arc<Frame>>, usize)>);

impl FrameCache {
    /// Limit of the total size in bytes: 1,900 frames of 240x320.
    const MOST: usize = 1 << 30;

    fn get(&self, index: usize) -> Option<Arc<Frame>> {
        self.0.lock().ok()?.0.get(&index).cloned()
    }

    fn insert(&self, index: usize, frame: &Arc<Frame>) {
        let maps = if frame.target.is_some() { 3 } else { 1 };
        let bytes = frame.rgb.as_raw().len() + maps * size_of_val(frame.depth.values());
        // A poisoned lock only costs time.
        if let Ok(mut frames) = self.0.lock()
            && frames.1 + bytes <= Self::MOST
            && frames.0.insert(index, frame.clone()).is_none()
        {
            frames.1 += bytes;
        }
    }
}

/// A loader that prepares batches ahead of their use. Worker `w` of `n` prepares the steps `w, w + n, ...`, so batches are in
/// order and independent of the number of workers.
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
                            // The receiver is dropped when training ends.
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

    /// Returns the samples of the next step.
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

#[cfg(test)]
mod tests {
    use super::*;
    use lsdc_eval::data::{FrameId, Rooms, RoomsConfig, Split};
    use std::sync::atomic::{AtomicUsize, Ordering};

    /// Rooms with a counter of reads.
    struct Counted(Rooms, AtomicUsize);

    impl Dataset for Counted {
        fn description(&self) -> String {
            self.0.description()
        }

        fn len(&self) -> usize {
            self.0.len()
        }

        fn id(&self, index: usize) -> FrameId {
            self.0.id(index)
        }

        fn load(&self, index: usize) -> Result<Frame> {
            self.1.fetch_add(1, Ordering::Relaxed);
            self.0.load(index)
        }
    }

    #[test]
    fn frames_are_read_once_and_samples_stay_the_same() {
        let rooms = RoomsConfig {
            width: 64,
            height: 48,
            ..RoomsConfig::default()
        };
        let rooms = Rooms::new(Split::Train, &rooms).unwrap();
        let frames = Arc::new(Counted(rooms, AtomicUsize::new(0)));
        let config = SamplerConfig {
            protocol: Protocol::default(),
            augment: AugmentConfig::default(),
            views: 0,
            supervision: SupervisionConfig {
                points: 50,
                fewest: 20,
                patches: 1,
                patch: 8,
                ..SupervisionConfig::default()
            },
            batch: 3,
            seed: 0,
        };
        let sampler = || Sampler::new(frames.clone(), vec![0, 1, 2, 3], config).unwrap();
        let depths = |sampler: &Sampler, step| -> Vec<Vec<f32>> {
            let samples = sampler.batch(step).unwrap();
            samples.iter().map(|sample| sample.map.clone()).collect()
        };
        let (one, other) = (sampler(), sampler());
        let first: Vec<_> = (0..8).map(|step| depths(&one, step)).collect();
        assert_eq!(frames.1.load(Ordering::Relaxed), 4);
        // In another order, by a sampler with an empty cache.
        for step in (0..8).rev() {
            assert_eq!(depths(&other, step), first[step]);
        }
        assert_eq!(frames.1.load(Ordering::Relaxed), 8);
    }

    #[test]
    fn a_number_of_views_comes_again_with_other_points() {
        let rooms = RoomsConfig {
            width: 64,
            height: 48,
            ..RoomsConfig::default()
        };
        let rooms = Arc::new(Rooms::new(Split::Train, &rooms).unwrap());
        let config = SamplerConfig {
            protocol: Protocol::default(),
            augment: AugmentConfig::default(),
            views: 2,
            supervision: SupervisionConfig {
                points: 50,
                fewest: 20,
                patches: 1,
                patch: 8,
                ..SupervisionConfig::default()
            },
            batch: 1,
            seed: 0,
        };
        let sampler = Sampler::new(rooms, vec![0], config).unwrap();
        let pass = |step| sampler.batch(step).unwrap().remove(0);
        let [first, second, third] = [0, 1, 2].map(pass);
        assert_ne!(first.rgb, second.rgb);
        assert_eq!((&first.rgb, &first.map), (&third.rgb, &third.map));
        assert_ne!(first.pixels, third.pixels);
    }
}
