//! What all requests share.

use crate::config::Config;
use crate::guard::Guard;
use crate::metrics::Metrics;
use crate::page::Index;
use crate::scenes::Scenes;
use crate::task::Task;
use crate::worker_pool::WorkerPool;
use lsdc_core::Completer;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// The state of a service.
pub(crate) struct App {
    pub(crate) completer: Completer,
    pub(crate) config: Config,
    pub(crate) pool: WorkerPool,
    pub(crate) scenes: Scenes,
    pub(crate) metrics: Arc<Metrics>,
    pub(crate) guard: Guard,
    pub(crate) gallery: Index,
    ends: AtomicBool,
}

impl App {
    /// Starts the threads that compute.
    ///
    /// # Errors
    /// Threads that cannot be started.
    pub(crate) fn new(
        completer: Completer,
        config: Config,
        address: SocketAddr,
    ) -> std::io::Result<Self> {
        let metrics = Arc::new(Metrics::default());
        let limits = &config.limits;
        let pool = WorkerPool::new(limits.workers, limits.queue, metrics.clone())?;
        Ok(Self {
            completer,
            pool,
            scenes: Scenes::new(limits.scenes, limits.expiry, metrics.clone()),
            guard: Guard::new(&config, address),
            gallery: Index::default(),
            metrics,
            config,
            ends: AtomicBool::new(false),
        })
    }

    /// A computation that begins now.
    pub(crate) fn task(&self) -> Arc<Task> {
        let (allowed, trace) = (self.config.limits.request, self.config.trace.clone());
        Arc::new(Task::new(allowed, self.metrics.clone(), trace))
    }

    /// The service takes no more requests.
    pub(crate) fn end(&self) {
        self.ends.store(true, Ordering::Relaxed);
    }

    /// Whether it takes requests.
    pub(crate) fn is_ready(&self) -> bool {
        !self.ends.load(Ordering::Relaxed)
    }
}
