//! A channel between two threads with room for one item.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// Holds one item until the other thread takes it.
pub(crate) struct Slot<T> {
    /// The item, and whether the slot is still open.
    contents: Mutex<(Option<T>, bool)>,
    changed: Condvar,
}

impl<T> Default for Slot<T> {
    fn default() -> Self {
        Self {
            contents: Mutex::new((None, true)),
            changed: Condvar::new(),
        }
    }
}

impl<T> Slot<T> {
    fn lock(&self) -> MutexGuard<'_, (Option<T>, bool)> {
        self.contents.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.lock().0.is_none()
    }

    /// Fills the slot, which must be empty.
    pub(crate) fn put(&self, thing: T) {
        self.lock().0 = Some(thing);
        self.changed.notify_one();
    }

    /// Blocks until there is an item, and takes it; `None` once the slot is closed and empty.
    pub(crate) fn take(&self) -> Option<T> {
        let waits = |(thing, is_open): &mut (Option<T>, bool)| thing.is_none() && *is_open;
        let contents = self.changed.wait_while(self.lock(), waits);
        contents.unwrap_or_else(PoisonError::into_inner).0.take()
    }

    /// Closes the slot: every wait ends. An item in it can still be taken.
    pub(crate) fn close(&self) {
        self.lock().1 = false;
        self.changed.notify_all();
    }
}
