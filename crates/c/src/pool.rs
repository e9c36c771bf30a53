//! Threads.

use crate::fault::{Fault, Result};
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::sync::{Arc, Mutex, PoisonError, Weak};

/// Threads of a pool.
const MOST: usize = 4096;

/// The pool that completers share, as long as one does.
static SHARED: Mutex<Weak<ThreadPool>> = Mutex::new(Weak::new());

/// A pool of `threads` threads; the shared one, with a thread per core, if `threads` is 0.
pub(crate) fn pool(threads: usize) -> Result<Arc<ThreadPool>> {
    if threads > 0 {
        return started(threads);
    }
    let mut shared = SHARED.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(pool) = shared.upgrade() {
        return Ok(pool);
    }
    let pool = started(0)?;
    *shared = Arc::downgrade(&pool);
    Ok(pool)
}

fn started(threads: usize) -> Result<Arc<ThreadPool>> {
    if threads > MOST {
        return Err(Fault::settings(format!(
            "a completer has at most {MOST} threads, not {threads}"
        )));
    }
    let named = |i| format!("lsdc-{i}");
    let pool = ThreadPoolBuilder::new()
        .num_threads(threads)
        .thread_name(named);
    let failed = |error| Fault::settings(format!("{threads} threads cannot be started: {error}"));
    pool.build().map(Arc::new).map_err(failed)
}

/// A value, and the threads that work on it.
#[derive(Clone)]
pub(crate) struct Pooled<T> {
    pub(crate) value: T,
    pub(crate) pool: Arc<ThreadPool>,
}

impl<T: Sync> Pooled<T> {
    /// Runs `work` on the pool.
    pub(crate) fn run<R: Send>(&self, work: impl FnOnce(&T) -> R + Send) -> R {
        self.pool.install(|| work(&self.value))
    }
}
