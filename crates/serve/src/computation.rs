//! A computation and its stages: their durations, and whether a client still waits for the result.

use crate::config::Trace;
use crate::fault::{Fault, FaultKind};
use crate::metrics::Metrics;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// The stages of a computation, between which it can stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Stage {
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
    /// Leave-one-out errors and the outlier test.
    OutlierTest,
    /// The bytes of the answer.
    Encode,
}

impl Stage {
    /// The name in metrics and traces.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Read => "read",
            Self::Network => "network",
            Self::Fit => "fit",
            Self::Depth => "depth",
            Self::Deviation => "standard-deviation",
            Self::OutlierTest => "judge",
            Self::Encode => "encode",
        }
    }
}

/// A computation that waits or runs.
pub(crate) struct Computation {
    stopped: AtomicBool,
    deadline: Instant,
    allowed: Duration,
    metrics: Arc<Metrics>,
    trace: Option<Trace>,
}

impl Computation {
    /// A computation that starts now and may take as long as is `allowed`.
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

    /// Ends it before its next stage.
    pub(crate) fn stop(&self) {
        self.stopped.store(true, Ordering::Relaxed);
    }

    /// Runs a stage and measures its time, unless the computation was stopped or is late.
    pub(crate) fn stage<T>(
        &self,
        stage: Stage,
        work: impl FnOnce() -> Result<T, Fault>,
    ) -> Result<(T, Duration), Fault> {
        if let Some(trace) = &self.trace {
            trace(stage.name());
        }
        if self.stopped.load(Ordering::Relaxed) {
            return Err(Fault::new(FaultKind::Gone, "the client has gone"));
        }
        if Instant::now() >= self.deadline {
            return Err(self.late());
        }
        let started = Instant::now();
        let result = work()?;
        let time = started.elapsed();
        self.metrics.add_stage(stage, time);
        Ok((result, time))
    }

    /// The fault of a computation that took too long.
    pub(crate) fn late(&self) -> Fault {
        let seconds = self.allowed.as_secs_f64();
        Fault::new(
            FaultKind::Late,
            format!("no answer within the {seconds} s of a request"),
        )
        .hint("send a smaller image or fewer points, or ask again later")
    }
}
