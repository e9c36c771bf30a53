//! The order of frames in training.

use lsdc_files::error::{Error, Result};
use lsdc_rng::Rng;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// An endless sequence of epochs. Each epoch mixes the frames of all parts in random order, as many of each part as its share
/// requires. Every frame of a part occurs once before any of them is repeated.
#[derive(Clone, Debug)]
pub struct Order {
    parts: Arc<[DatasetShare]>,
    cache: Arc<Mutex<VecDeque<Epoch>>>,
}

/// The frames of an epoch in order, and the number of previous occurrences of each.
#[derive(Clone, Debug)]
struct Epoch {
    number: usize,
    seed: u64,
    frames: Arc<[(usize, usize)]>,
}

#[derive(Debug)]
struct DatasetShare {
    frames: Vec<usize>,
    /// Number of its frames in an epoch.
    count: usize,
}

impl From<Vec<usize>> for Order {
    /// Creates an order with every frame once per epoch.
    fn from(frames: Vec<usize>) -> Self {
        let count = frames.len();
        Self::of([DatasetShare { frames, count }].into())
    }
}

impl Order {
    /// Creates an order from the frames of each part and its share of an epoch. Frames of parts without a share occur once per
    /// epoch.
    ///
    /// # Errors
    /// Shares are not above 0 or leave none to the parts without one, or a part has no frames.
    pub fn new(parts: Vec<(Vec<usize>, Option<f64>)>) -> Result<Self> {
        let shares: f64 = parts.iter().filter_map(|(_, share)| *share).sum();
        let unshared = parts.iter().filter(|(_, share)| share.is_none());
        let unshared: usize = unshared.map(|(frames, _)| frames.len()).sum();
        let positive = parts.iter().all(|(_, share)| share.is_none_or(|s| s > 0.0));
        if !positive || shares >= 1.0 || parts.iter().any(|(frames, _)| frames.is_empty()) {
            return Err(Error::config(
                "the shares of datasets must be above 0 and add up to less than 1, and none may be empty",
            ));
        }
        let epoch = unshared as f64 / (1.0 - shares);
        let parts = parts.into_iter().map(|(frames, share)| DatasetShare {
            count: share.map_or(frames.len(), |s| ((s * epoch).round() as usize).max(1)),
            frames,
        });
        Ok(Self::of(parts.collect()))
    }

    fn of(parts: Arc<[DatasetShare]>) -> Self {
        Self {
            parts,
            cache: Arc::default(),
        }
    }

    /// Returns the number of frames in an epoch.
    pub fn epoch(&self) -> usize {
        self.parts.iter().map(|part| part.count).sum()
    }

    /// Returns all frames.
    pub fn frames(&self) -> impl Iterator<Item = usize> {
        self.parts
            .iter()
            .flat_map(|part| part.frames.iter().copied())
    }

    /// Returns the frame at a position of the sequence, and the number of its previous occurrences.
    pub fn at(&self, position: usize, seed: u64) -> (usize, usize) {
        let length = self.epoch();
        self.of_epoch(position / length, seed)[position % length]
    }

    /// Returns the frames of an epoch, shuffled once for all threads: at the end of an epoch, some threads are in the next one.
    fn of_epoch(&self, number: usize, seed: u64) -> Arc<[(usize, usize)]> {
        const CACHED: usize = 2;
        let same = |epoch: &&Epoch| (epoch.number, epoch.seed) == (number, seed);
        if let Some(epoch) = self.cached().iter().find(same) {
            return epoch.frames.clone();
        }
        let parts = self.parts.iter().enumerate();
        let all = parts.flat_map(|(part, own)| own.of_epoch(number, part, seed));
        let mut all: Vec<(usize, usize)> = all.collect();
        let count = all.len();
        Rng::stream(seed, &["order", &number.to_string()]).choose(&mut all, count);
        let frames: Arc<[(usize, usize)]> = all.into();
        let mut cached = self.cached();
        cached.push_front(Epoch {
            number,
            seed,
            frames: frames.clone(),
        });
        cached.truncate(CACHED);
        frames
    }

    fn cached(&self) -> MutexGuard<'_, VecDeque<Epoch>> {
        self.cache.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl DatasetShare {
    /// Returns the frames of an epoch, and the number of previous occurrences of each.
    fn of_epoch(&self, epoch: usize, number: usize, seed: u64) -> Vec<(usize, usize)> {
        let length = self.frames.len();
        if self.count == length {
            return self.frames.iter().map(|&frame| (frame, epoch)).collect();
        }
        let (first, end) = (epoch * self.count, (epoch + 1) * self.count);
        let passes = first / length..end.div_ceil(length);
        let found = passes.flat_map(|pass| {
            let mut order = self.frames.clone();
            let keys = ["part", &number.to_string(), &pass.to_string()];
            Rng::stream(seed, &keys).choose(&mut order, length);
            let positions = (pass * length..).zip(order);
            let within = positions.filter(move |(at, _)| (first..end).contains(at));
            within.map(move |(_, frame)| (frame, pass))
        });
        found.collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::{BTreeMap, BTreeSet};

    #[test]
    fn every_part_has_its_share_and_every_frame_its_turn() {
        // 6 frames of the first part are half an epoch: 3 of the second, 3 of the third.
        let parts = vec![
            ((0..6).collect(), None),
            ((6..17).collect(), Some(0.25)),
            (vec![17, 18], Some(0.25)),
        ];
        let order = Order::new(parts).unwrap();
        assert_eq!(order.epoch(), 12);
        assert!(order.frames().eq(0..19));
        let mut seen: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for epoch in 0..11 {
            let mut counts = [0; 3];
            for position in epoch * 12..(epoch + 1) * 12 {
                let (frame, before) = order.at(position, 7);
                counts[if frame < 6 {
                    0
                } else if frame < 17 {
                    1
                } else {
                    2
                }] += 1;
                seen.entry(frame).or_default().push(before);
            }
            assert_eq!(counts, [6, 3, 3]);
        }
        for (frame, before) in seen {
            let times = if frame < 6 {
                11
            } else if frame < 17 {
                3
            } else {
                before.len()
            };
            let expected: BTreeSet<usize> = (0..times).collect();
            assert_eq!(before.len(), times, "{frame}");
            assert_eq!(before.into_iter().collect::<BTreeSet<_>>(), expected);
        }
    }

    #[test]
    fn orders_depend_on_the_seed_and_shares_must_leave_something() {
        let order = Order::from((0..9).collect::<Vec<_>>());
        let all = |seed| (0..9).map(|at| order.at(at, seed)).collect::<Vec<_>>();
        assert_eq!(all(1), all(1));
        assert_ne!(all(1), all(2));
        // A few epochs are cached, whatever the order in which they are requested.
        let jumps = |seed| [40, 3, 22, 4, 41].map(|at| order.at(at, seed));
        let fresh = |seed| {
            let order = || Order::from((0..9).collect::<Vec<_>>());
            [40, 3, 22, 4, 41].map(|at| order().at(at, seed))
        };
        assert_eq!((jumps(1), jumps(2)), (fresh(1), fresh(2)));
        assert_eq!(order.cached().len(), 2);
        let of = |number| order.of_epoch(number, 2);
        assert!(Arc::ptr_eq(&of(4), &of(4)));
        for share in [0.0, -0.5, 1.0, f64::NAN] {
            let parts = vec![(vec![0], None), (vec![1], Some(share))];
            assert!(Order::new(parts).is_err(), "{share}");
        }
        assert!(Order::new(vec![(vec![0], None), (vec![], None)]).is_err());
    }
}
