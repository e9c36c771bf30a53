//! Threads that compute, apart from those that serve connections, and the queue before them.

use crate::fault::{Fault, Kind};
use crate::metrics::Metrics;
use crate::task::Task;
use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, oneshot};

/// The threads, and the places in their queue.
pub(crate) struct WorkerPool {
    queue: Arc<Queue>,
    /// A place for each request from its head until its answer has been sent.
    places: Arc<Semaphore>,
    threads: Vec<JoinHandle<()>>,
    metrics: Arc<Metrics>,
}

/// A place of a request, which is free again when this is dropped.
pub(crate) struct QueueSlot {
    metrics: Arc<Metrics>,
    _permit: OwnedSemaphorePermit,
}

impl Drop for QueueSlot {
    fn drop(&mut self) {
        self.metrics.add_places(-1);
    }
}

struct Queue {
    state: Mutex<State>,
    changed: Condvar,
    metrics: Arc<Metrics>,
}

#[derive(Default)]
struct State {
    waiting: VecDeque<(u64, Job)>,
    next: u64,
    closed: bool,
    /// Seconds that a computation takes, on average.
    usual: f64,
}

type Job = Box<dyn FnOnce() + Send>;

impl WorkerPool {
    /// Starts the threads.
    ///
    /// # Errors
    /// A thread that cannot be started.
    pub(crate) fn new(
        workers: usize,
        queue: usize,
        metrics: Arc<Metrics>,
    ) -> std::io::Result<Self> {
        let count = match workers {
            0 => std::thread::available_parallelism().map_or(1, usize::from),
            count => count,
        };
        let shared = Arc::new(Queue {
            state: Mutex::default(),
            changed: Condvar::new(),
            metrics: metrics.clone(),
        });
        let mut pool = Self {
            queue: shared,
            places: Arc::new(Semaphore::new(count.saturating_add(queue))),
            threads: Vec::new(),
            metrics,
        };
        for number in 0..count {
            let queue = pool.queue.clone();
            let thread = std::thread::Builder::new().name(format!("lsdc-work-{number}"));
            pool.threads.push(thread.spawn(move || queue.work())?);
        }
        Ok(pool)
    }

    /// A place for a request, which is taken before its body is read and held until its answer has been sent: there are
    /// never more bodies, computations and answers than places.
    ///
    /// # Errors
    /// All are taken.
    pub(crate) fn place(&self) -> Result<QueueSlot, Fault> {
        let permit = self.places.clone().try_acquire_owned();
        let permit = permit.map_err(|_| self.full())?;
        self.metrics.add_places(1);
        Ok(QueueSlot {
            metrics: self.metrics.clone(),
            _permit: permit,
        })
    }

    fn full(&self) -> Fault {
        let state = self.queue.lock();
        let rounds = (state.waiting.len() / self.threads.len().max(1) + 1) as f64;
        let after = Duration::from_secs_f64((state.usual * rounds).ceil().clamp(1.0, 60.0));
        Fault::new(Kind::Full, "the service is busy and its queue is full")
            .hint("ask again after the seconds that Retry-After says")
            .retry(after)
    }

    /// Computes on one of the threads. If the caller no longer waits, as its client has gone, the task is stopped: it
    /// leaves the queue, or ends before its next part.
    ///
    /// # Errors
    /// Those of the work; a panic in it; the end of its time.
    pub(crate) async fn run<T: Send + 'static>(
        &self,
        task: &Arc<Task>,
        work: impl FnOnce(&Task) -> Result<T, Fault> + Send + 'static,
    ) -> Result<T, Fault> {
        let (sender, receiver) = oneshot::channel();
        let (own, metrics) = (task.clone(), self.metrics.clone());
        let job = Box::new(move || {
            let result = catch_unwind(AssertUnwindSafe(|| work(&own)));
            let _ = sender.send(result.unwrap_or_else(|_| {
                metrics.panicked();
                Err(Fault::failed())
            }));
        });
        let abandoned = Abandoned {
            number: self.queue.push(job),
            queue: &self.queue,
            task,
        };
        let result = tokio::time::timeout_at(task.deadline().into(), receiver).await;
        drop(abandoned);
        match result {
            Ok(Ok(result)) => result,
            Ok(Err(_)) => Err(Fault::failed()),
            Err(_) => Err(task.late()),
        }
    }
}

impl Drop for WorkerPool {
    /// What is being computed is finished, what waits is not begun.
    fn drop(&mut self) {
        let mut state = self.queue.lock();
        state.closed = true;
        state.waiting.clear();
        drop(state);
        self.queue.changed.notify_all();
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

/// Stops a task when nobody waits for it any more.
struct Abandoned<'a> {
    number: u64,
    queue: &'a Queue,
    task: &'a Task,
}

impl Drop for Abandoned<'_> {
    fn drop(&mut self) {
        self.task.stop();
        self.queue.remove(self.number);
    }
}

impl Queue {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn push(&self, job: Job) -> u64 {
        let mut state = self.lock();
        let number = state.next;
        state.next += 1;
        state.waiting.push_back((number, job));
        self.metrics.set_waiting(state.waiting.len());
        drop(state);
        self.changed.notify_one();
        number
    }

    fn remove(&self, number: u64) {
        let mut state = self.lock();
        state.waiting.retain(|(own, _)| *own != number);
        self.metrics.set_waiting(state.waiting.len());
    }

    fn work(&self) {
        while let Some(job) = self.next() {
            let started = Instant::now();
            self.metrics.add_working(1);
            job();
            self.metrics.add_working(-1);
            self.note(started.elapsed());
        }
    }

    fn next(&self) -> Option<Job> {
        let mut state = self.lock();
        loop {
            if state.closed {
                return None;
            }
            if let Some((_, job)) = state.waiting.pop_front() {
                self.metrics.set_waiting(state.waiting.len());
                return Some(job);
            }
            let woken = self.changed.wait(state);
            state = woken.unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// A running mean over about ten computations.
    fn note(&self, time: Duration) {
        let mut state = self.lock();
        state.usual += 0.1 * (time.as_secs_f64() - state.usual);
    }
}
