//! One computation: its parts, how long they take, and whether it is still wanted.

use crate::config::Trace;
use crate::fault::{Fault, Kind};
use crate::metrics::Metrics;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// The parts of a computation, between which it can stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Part {
    /// Image, camera and points from their files.
    Read,
    /// The network, on the image alone.
    Network,
    /// The fit to the points.
    Fit,
    /// The dense depth.
    Depth,
    /// The standard deviation of every pixel.
    Deviation,
    /// What the points say of each other.
    Judge,
    /// The bytes of the answer.
    Encode,
}

impl Part {
    /// The name in metrics and traces.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Read => "read",
            Self::Network => "network",
            Self::Fit => "fit",
            Self::Depth => "depth",
            Self::Deviation => "standard-deviation",
            Self::Judge => "judge",
            Self::Encode => "encode",
        }
    }
}

/// A computation on its way.
pub(crate) struct Task {
    stopped: AtomicBool,
    deadline: Instant,
    allowed: Duration,
    metrics: Arc<Metrics>,
    trace: Option<Trace>,
}

impl Task {
    pub(crate) fn new(allowed: Duration, metrics: Arc<Metrics>, trace: Option<Trace>) -> Self {
        Self {
            stopped: AtomicBool::new(false),
            deadline: Instant::now() + allowed,
            allowed,
            metrics,
            trace,
        }
    }

    /// When it must be done.
    pub(crate) fn deadline(&self) -> Instant {
        self.deadline
    }

    /// Nobody wants it any more.
    pub(crate) fn stop(&self) {
        self.stopped.store(true, Ordering::Relaxed);
    }

    /// Does a part, unless the whole is no longer wanted, and says how long it took.
    pub(crate) fn part<T>(
        &self,
        part: Part,
        work: impl FnOnce() -> Result<T, Fault>,
    ) -> Result<(T, Duration), Fault> {
        if let Some(trace) = &self.trace {
            trace(part.name());
        }
        if self.stopped.load(Ordering::Relaxed) {
            return Err(Fault::new(Kind::Gone, "the client has gone"));
        }
        if Instant::now() >= self.deadline {
            return Err(self.late());
        }
        let started = Instant::now();
        let result = work()?;
        let time = started.elapsed();
        self.metrics.add_part(part, time);
        Ok((result, time))
    }

    /// That the time is over.
    pub(crate) fn late(&self) -> Fault {
        let seconds = self.allowed.as_secs_f64();
        Fault::new(
            Kind::Late,
            format!("no answer within the {seconds} s of a request"),
        )
        .hint("send a smaller image or fewer points, or ask again later")
    }
}
