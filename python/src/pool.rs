//! The threads that calls run on, which do not survive a fork.

use crate::error::{ExceptionKind, raised};
use lsdc_core::{Result, thread_pool};
use pyo3::prelude::*;
use rayon::ThreadPool;
use std::sync::{Arc, Mutex, PoisonError};

/// A pool of this process, or of the one that it was forked from.
#[derive(Clone)]
pub(crate) struct Pool {
    threads: Arc<ThreadPool>,
    process: u32,
}

/// The pool of all calls without one of their own.
static SHARED: Mutex<Option<Pool>> = Mutex::new(None);

impl Pool {
    /// The shared pool of this process, with a thread for every core.
    pub(crate) fn shared(py: Python<'_>) -> PyResult<Self> {
        let mut shared = SHARED.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(pool) = shared.as_ref().filter(|pool| pool.is_here()) {
            return Ok(pool.clone());
        }
        let pool = Self::new(py, 0)?;
        // The threads of a pool from before a fork cannot be awaited.
        std::mem::forget(shared.replace(pool.clone()));
        Ok(pool)
    }

    /// A new pool, with a thread for every core if `threads` is 0.
    pub(crate) fn new(py: Python<'_>, threads: usize) -> PyResult<Self> {
        let threads = thread_pool(threads).map_err(|error| raised(py, &error))?;
        Ok(Self {
            threads,
            process: std::process::id(),
        })
    }

    /// Whether the threads are of this process.
    fn is_here(&self) -> bool {
        self.process == std::process::id()
    }

    pub(crate) fn threads(&self) -> Arc<ThreadPool> {
        self.threads.clone()
    }

    pub(crate) fn count(&self) -> usize {
        self.threads.current_num_threads()
    }

    /// Runs work of `lsdc-core` on the pool, and lets other threads of the interpreter run meanwhile.
    ///
    /// # Errors
    /// Those of the work, or a process that was forked since.
    pub(crate) fn run<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce() -> Result<T> + Send,
    ) -> PyResult<T> {
        self.install(py, work)?.map_err(|error| raised(py, &error))
    }

    /// The same with work of any kind.
    ///
    /// # Errors
    /// A process that was forked since.
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
