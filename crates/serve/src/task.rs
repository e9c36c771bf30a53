//! One computation: how long its parts take, and whether it is still wanted.

use crate::config::Trace;
use crate::fault::{Fault, Kind};
use crate::metrics::Metrics;
use crate::part::Part;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

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
