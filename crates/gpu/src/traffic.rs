//! Counters of launches and transfers.

use serde::Serialize;
use std::ops::Sub;
use std::sync::{Mutex, PoisonError};

/// A part of a completion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Cached preparations: weights, and what depends only on the image size.
    Preparation,
    /// From an image to features and affinities.
    Network,
    /// Basis functions at the points.
    Functions,
    /// Basis functions times weights at every pixel.
    Map,
}

impl Part {
    /// All parts, in the order of a completion.
    pub const ALL: [Self; 4] = [Self::Preparation, Self::Network, Self::Functions, Self::Map];

    /// The name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Preparation => "preparation",
            Self::Network => "network",
            Self::Functions => "functions",
            Self::Map => "map",
        }
    }
}

/// Work and transfers of a GPU.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Traffic {
    /// Kernels launched.
    pub launches: u64,
    /// Submissions to the queue.
    pub submissions: u64,
    /// Transfers to the GPU.
    pub uploads: u64,
    /// Transfers from the GPU, for each of which the CPU waits.
    pub readbacks: u64,
    /// Bytes of all uploads.
    pub bytes_up: u64,
    /// Bytes of all transfers back.
    pub bytes_down: u64,
}

impl Traffic {
    fn each(self, other: Self, combine: impl Fn(u64, u64) -> u64) -> Self {
        Self {
            launches: combine(self.launches, other.launches),
            submissions: combine(self.submissions, other.submissions),
            uploads: combine(self.uploads, other.uploads),
            readbacks: combine(self.readbacks, other.readbacks),
            bytes_up: combine(self.bytes_up, other.bytes_up),
            bytes_down: combine(self.bytes_down, other.bytes_down),
        }
    }
}

impl Sub for Traffic {
    type Output = Self;

    /// The difference to an earlier count.
    fn sub(self, earlier: Self) -> Self {
        self.each(earlier, u64::wrapping_sub)
    }
}

impl std::iter::Sum for Traffic {
    fn sum<I: Iterator<Item = Self>>(parts: I) -> Self {
        parts.fold(Self::default(), |sum, part| {
            sum.each(part, u64::wrapping_add)
        })
    }
}

/// The counts of all parts since a device was opened.
#[derive(Debug, Default)]
pub(crate) struct Counters(Mutex<[Traffic; Part::ALL.len()]>);

impl Counters {
    pub(crate) fn add(&self, part: Part, more: Traffic) {
        let mut counts = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let count = &mut counts[part as usize];
        *count = [*count, more].into_iter().sum();
    }

    pub(crate) fn all(&self) -> [(Part, Traffic); Part::ALL.len()] {
        let counts = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        Part::ALL.map(|part| (part, counts[part as usize]))
    }
}
