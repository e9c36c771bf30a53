//! The clock of a node, which tests control.

use lsdc_recordings::{Receipt, Timestamp};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime};

/// A source of time.
pub trait Clock: Send + Sync {
    /// Monotonic time since an arbitrary start.
    fn elapsed(&self) -> Duration;

    /// Nanoseconds since 1970, as in message stamps.
    fn stamp(&self) -> Timestamp;

    /// Both.
    fn receipt(&self) -> Receipt {
        Receipt {
            at: self.elapsed(),
            stamp: self.stamp(),
        }
    }
}

/// The system clock.
#[derive(Clone, Copy, Debug)]
pub struct SystemClock(Instant);

impl Default for SystemClock {
    fn default() -> Self {
        Self(Instant::now())
    }
}

impl Clock for SystemClock {
    fn elapsed(&self) -> Duration {
        self.0.elapsed()
    }

    fn stamp(&self) -> Timestamp {
        let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
        since.map_or(0, |since| {
            i64::try_from(since.as_nanos()).unwrap_or(i64::MAX)
        })
    }
}

/// A clock that only tests advance.
#[derive(Debug, Default)]
pub struct ManualClock(Mutex<(Duration, Timestamp)>);

impl ManualClock {
    /// Sets the stamp; if it is later, the monotonic time advances by the difference.
    pub fn set(&self, stamp: Timestamp) {
        let mut now = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let (elapsed, before) = *now;
        let passed = u64::try_from(stamp.saturating_sub(before)).unwrap_or(0);
        let passed = if before == 0 { 0 } else { passed };
        *now = (elapsed.saturating_add(Duration::from_nanos(passed)), stamp);
    }

    /// Advances both times.
    pub fn advance(&self, time: Duration) {
        let mut now = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        now.0 = now.0.saturating_add(time);
        now.1 = now.1.saturating_add(time.as_nanos() as i64);
    }
}

impl Clock for ManualClock {
    fn elapsed(&self) -> Duration {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).0
    }

    fn stamp(&self) -> Timestamp {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).1
    }
}

impl<C: Clock + ?Sized> Clock for std::sync::Arc<C> {
    fn elapsed(&self) -> Duration {
        (**self).elapsed()
    }

    fn stamp(&self) -> Timestamp {
        (**self).stamp()
    }
}
