//! The queue of the computations: how many run at a time, on threads that may block, and how many requests there are.

use crate::computation::Computation;
use crate::fault::{Fault, FaultKind};
use crate::metrics::{Counted, Metrics, Scalar};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::task::spawn_blocking;
use tokio::time::timeout_at;

/// The permits of computations and requests.
pub(crate) struct WorkerPool {
    workers: usize,
    /// A permit for each computation that runs; the others wait in their order.
    permits: Arc<Semaphore>,
    /// A slot for each request from its head until its answer has been sent.
    slots: Arc<Semaphore>,
    mean_seconds: Arc<Mutex<f64>>,
    metrics: Arc<Metrics>,
}

/// The slot of a request, which is free again when this is dropped.
pub(crate) struct QueueSlot {
    _counted: Counted,
    _permit: OwnedSemaphorePermit,
}

impl WorkerPool {
    /// Creates a pool with `workers` simultaneous computations (0: one per core) and up to `queue` waiting requests.
    pub(crate) fn new(workers: usize, queue: usize, metrics: Arc<Metrics>) -> Self {
        let workers = match workers {
            0 => std::thread::available_parallelism().map_or(1, usize::from),
            count => count,
        };
        Self {
            workers,
            permits: Arc::new(Semaphore::new(workers)),
            slots: Arc::new(Semaphore::new(workers.saturating_add(queue))),
            mean_seconds: Arc::default(),
            metrics,
        }
    }

    /// Number of threads that may block at once: those that read bodies and those that compute, so
    /// that slow clients keep no computation from its thread.
    pub(crate) fn max_threads(&self) -> usize {
        self.workers.saturating_add(self.slots.available_permits())
    }

    /// A slot for a request, which is taken before its body is read and released when its answer has been sent: there are
    /// never more bodies, computations and answers than slots.
    ///
    /// # Errors
    /// All slots are in use.
    pub(crate) fn slot(&self) -> Result<QueueSlot, Fault> {
        let permit = self.slots.clone().try_acquire_owned();
        Ok(QueueSlot {
            _permit: permit.map_err(|_| self.full())?,
            _counted: self.metrics.counted(Scalar::QueueSlots),
        })
    }

    fn full(&self) -> Fault {
        let waiting = self.metrics.get(Scalar::Waiting) as usize;
        let rounds = (waiting / self.workers + 1) as f64;
        let mean = *lock(&self.mean_seconds);
        let after = Duration::from_secs_f64((mean * rounds).ceil().clamp(1.0, 60.0));
        Fault::new(FaultKind::Full, "the service is busy and its queue is full")
            .hint("ask again after the seconds that Retry-After says")
            .retry(after)
    }

    /// Computes on a thread that may block. If the caller no longer waits, as its client has gone, the computation leaves
    /// the queue, or ends before its next stage.
    ///
    /// # Errors
    /// Those of the work; a panic in it; the end of its time.
    pub(crate) async fn run<T: Send + 'static>(
        &self,
        computation: &Arc<Computation>,
        work: impl FnOnce(&Computation) -> Result<T, Fault> + Send + 'static,
    ) -> Result<T, Fault> {
        let _stop = StopOnDrop(computation);
        let deadline = tokio::time::Instant::from_std(computation.deadline());
        let waiting = self.metrics.counted(Scalar::Waiting);
        let permit = timeout_at(deadline, self.permits.clone().acquire_owned()).await;
        drop(waiting);
        let permit = permit
            .map_err(|_| computation.late())?
            .map_err(|_| Fault::failed())?;
        let (running, metrics) = (computation.clone(), self.metrics.clone());
        let mean_seconds = self.mean_seconds.clone();
        let job = spawn_blocking(move || {
            let _permit = permit;
            let _working = metrics.counted(Scalar::Working);
            let started = Instant::now();
            let result = catch_unwind(AssertUnwindSafe(|| work(&running)));
            // A running mean, over about ten computations.
            let seconds = started.elapsed().as_secs_f64();
            let mut mean = lock(&mean_seconds);
            *mean += 0.1 * (seconds - *mean);
            drop(mean);
            result.unwrap_or_else(|_| {
                metrics.add(Scalar::Panics, 1);
                Err(Fault::failed())
            })
        });
        match timeout_at(deadline, job).await {
            Ok(Ok(result)) => result,
            Ok(Err(_)) => Err(Fault::failed()),
            Err(_) => Err(computation.late()),
        }
    }
}

fn lock(mean: &Mutex<f64>) -> MutexGuard<'_, f64> {
    mean.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Stops a computation when nobody waits for it any more.
struct StopOnDrop<'a>(&'a Computation);

impl Drop for StopOnDrop<'_> {
    fn drop(&mut self) {
        self.0.stop();
    }
}
