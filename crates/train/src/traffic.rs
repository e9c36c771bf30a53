//! Counters of what training makes a device do: launches of GPU kernels, and values read back.
//!
//! ```
//! use lsdc_train::device::device;
//! use lsdc_train::model::{InitNetwork as _, parameters::tables};
//! use lsdc_train::traffic::counted;
//! # fn main() -> lsdc_files::error::Result<()> {
//! let net = lsdc_core::network::NetworkConfig::small().init(0, &device("cpu")?)?;
//! let (tables, traffic) = counted(|| tables(&net));
//! assert_eq!(traffic.readbacks, tables.len() as u64);
//! assert!(traffic.launches.is_empty(), "the CPU launches no kernels");
//! # Ok(())
//! # }
//! ```

use serde::Serialize;
use std::cell::RefCell;
use std::collections::BTreeMap;

/// What one thread made its devices do.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Traffic {
    /// Launches of GPU kernels, by the name of the kernel.
    pub launches: BTreeMap<String, u64>,
    /// Tensors whose values this library read. On a GPU, the CPU waits for each.
    pub readbacks: u64,
}

impl Traffic {
    /// Returns the number of launches of all kernels.
    pub fn launched(&self) -> u64 {
        self.launches.values().sum()
    }
}

thread_local! {
    static COUNTS: RefCell<Option<Traffic>> = const { RefCell::new(None) };
}

/// Runs a function, and counts what it does on this thread. An outer count does not include an inner one.
pub fn counted<T>(run: impl FnOnce() -> T) -> (T, Traffic) {
    let outer = COUNTS.replace(Some(Traffic::default()));
    #[cfg(feature = "wgpu")]
    let watching = launches::watch();
    let result = run();
    #[cfg(feature = "wgpu")]
    drop(watching);
    (result, COUNTS.replace(outer).unwrap_or_default())
}

/// Counts a tensor whose values are read.
pub(crate) fn count_readback() {
    count(|traffic| traffic.readbacks += 1);
}

fn count(add: impl FnOnce(&mut Traffic)) {
    COUNTS.with_borrow_mut(|counts| {
        if let Some(counts) = counts {
            add(counts);
        }
    });
}

#[cfg(feature = "wgpu")]
mod launches {
    use burn_cubecl::cubecl::logging::{LaunchObservation, LaunchObserver};
    use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

    struct Counter;

    impl LaunchObserver for Counter {
        fn launched(&self, kernel: &'static str) {
            super::count(|traffic| *traffic.launches.entry(kernel.to_owned()).or_default() += 1);
        }
    }

    /// The number of counts under way, and the observation that they share: cubecl has one observer at a time.
    static WATCHING: Mutex<(usize, Option<LaunchObservation>)> = Mutex::new((0, None));

    fn watching() -> MutexGuard<'static, (usize, Option<LaunchObservation>)> {
        WATCHING.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Observes launches until it is dropped.
    pub(super) struct Watch;

    pub(super) fn watch() -> Watch {
        let mut watching = watching();
        watching.0 += 1;
        watching
            .1
            .get_or_insert_with(|| LaunchObservation::new(Arc::new(Counter)));
        Watch
    }

    impl Drop for Watch {
        fn drop(&mut self) {
            let mut watching = watching();
            watching.0 -= 1;
            if watching.0 == 0 {
                watching.1 = None;
            }
        }
    }
}
