//! Thread pools of completers.

use crate::error::{Error, Result};
use lsdc_core::thread_pool;
use rayon::ThreadPool;
use std::sync::{Arc, Mutex, PoisonError, Weak};

/// The threads of a completer, and the id of their process: a forked process has no threads of its parent.
#[derive(Clone)]
pub(crate) struct Pool {
    pub(crate) threads: Arc<ThreadPool>,
    process: u32,
}

/// The threads shared by completers, which exist as long as one uses them, and their process.
static SHARED: Mutex<(Weak<ThreadPool>, u32)> = Mutex::new((Weak::new(), 0));

impl Pool {
    /// Creates a pool of `threads` threads; 0 returns the shared pool with a thread per core.
    pub(crate) fn new(threads: usize) -> Result<Self> {
        let process = std::process::id();
        if threads > 0 {
            let threads = thread_pool(threads)?;
            return Ok(Self { threads, process });
        }
        let mut shared = SHARED.lock().unwrap_or_else(PoisonError::into_inner);
        let threads = match shared.0.upgrade() {
            Some(threads) if shared.1 == process => threads,
            _ => thread_pool(0)?,
        };
        *shared = (Arc::downgrade(&threads), process);
        Ok(Self { threads, process })
    }
}

/// A value and the threads that work on it.
#[derive(Clone)]
pub(crate) struct Pooled<T> {
    pub(crate) value: T,
    pub(crate) pool: Pool,
}

impl<T: Sync> Pooled<T> {
    /// Runs `work` on the pool.
    pub(crate) fn run<R: Send>(&self, work: impl FnOnce(&T) -> Result<R> + Send) -> Result<R> {
        // No thread would run it.
        if self.pool.process != std::process::id() {
            return Err(Error::forked());
        }
        self.pool.threads.install(|| work(&self.value))
    }
}
