//! Threads of calls, which do not survive a fork.

use crate::error::{ExceptionKind, raised};
use lsdc_core::{Result, thread_pool};
use pyo3::prelude::*;
use rayon::ThreadPool;
use std::sync::{Arc, Mutex, PoisonError};

/// A pool of this process, or of the process from which it was forked.
#[derive(Clone)]
pub(crate) struct Pool {
    threads: Arc<ThreadPool>,
    process: u32,
}

/// The pool shared by calls without a separate pool.
static SHARED: Mutex<Option<Pool>> = Mutex::new(None);

impl Pool {
    /// Returns the shared pool of this process, with a thread per core.
    pub(crate) fn shared(py: Python<'_>) -> PyResult<Self> {
        let mut shared = SHARED.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(pool) = shared.as_ref().filter(|pool| pool.is_here()) {
            return Ok(pool.clone());
        }
        let pool = Self::new(py, 0)?;
        // Do not drop a pool from before a fork, which would wait for its threads.
        std::mem::forget(shared.replace(pool.clone()));
        Ok(pool)
    }

    /// Creates a pool, with a thread per core if `threads` is 0.
    pub(crate) fn new(py: Python<'_>, threads: usize) -> PyResult<Self> {
        let threads = thread_pool(threads).map_err(|error| raised(py, &error))?;
        Ok(Self {
            threads,
            process: std::process::id(),
        })
    }

    /// Whether the threads belong to this process.
    fn is_here(&self) -> bool {
        self.process == std::process::id()
    }

    pub(crate) fn threads(&self) -> Arc<ThreadPool> {
        self.threads.clone()
    }

    pub(crate) fn count(&self) -> usize {
        self.threads.current_num_threads()
    }

    /// Runs work of `lsdc-core` on the pool, and releases the interpreter meanwhile.
    ///
    /// # Errors
    /// The errors of the work, or the process was forked since.
    pub(crate) fn run<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce() -> Result<T> + Send,
    ) -> PyResult<T> {
        self.install(py, work)?.map_err(|error| raised(py, &error))
    }

    /// Runs work of any kind on the pool, and releases the interpreter meanwhile.
    ///
    /// # Errors
    /// The process was forked since.
    pub(crate) fn install<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce() -> T + Send,
    ) -> PyResult<T> {
        if !self.is_here() {
            let what = "this was made before the process was forked, and its threads are not here";
            let hint = "make scenes after the fork, or start processes with \"spawn\"";
            return Err(ExceptionKind::Base.raise(py, what, Some(hint)));
        }
        Ok(py.detach(|| self.threads.install(work)))
    }
}
