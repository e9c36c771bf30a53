//! State shared by all requests.

use crate::computation::Computation;
use crate::config::Config;
use crate::fault::Fault;
use crate::guard::Guard;
use crate::metrics::Metrics;
use crate::page::GalleryCache;
use crate::scene_cache::SceneCache;
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
    pub(crate) scenes: SceneCache,
    pub(crate) metrics: Arc<Metrics>,
    pub(crate) guard: Guard,
    pub(crate) gallery: GalleryCache,
    ends: AtomicBool,
}

impl App {
    /// The state of a service that listens on this address.
    pub(crate) fn new(completer: Completer, config: Config, address: SocketAddr) -> Self {
        let metrics = Arc::new(Metrics::default());
        let limits = &config.limits;
        let pool = WorkerPool::new(limits.workers, limits.queue, metrics.clone());
        Self {
            completer,
            pool,
            scenes: SceneCache::new(limits.scenes, limits.expiry, metrics.clone()),
            guard: Guard::new(&config, address),
            gallery: GalleryCache::default(),
            metrics,
            config,
            ends: AtomicBool::new(false),
        }
    }

    /// Computes on a thread of the pool, within the time that a request may take.
    ///
    /// # Errors
    /// As for [`WorkerPool::run`].
    pub(crate) async fn run<T: Send + 'static>(
        &self,
        work: impl FnOnce(&Computation) -> Result<T, Fault> + Send + 'static,
    ) -> Result<T, Fault> {
        let (allowed, trace) = (self.config.limits.request, self.config.trace.clone());
        let computation = Arc::new(Computation::new(allowed, self.metrics.clone(), trace));
        self.pool.run(&computation, work).await
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
