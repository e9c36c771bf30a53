//! Handles: numbers in the form of pointers, and the tables of their objects.
//!
//! A number is used only once, so freed handles (twice, or while another thread uses them) and handles that never existed
//! are detected. Handles are never dereferenced.

use crate::error::{Error, Result};
use std::collections::BTreeMap;
use std::marker::PhantomData;
use std::ptr::without_provenance_mut;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{PoisonError, RwLock};

/// No address of x86-64 or AArch64 begins like this: a pointer of the caller is not taken for a handle, and dereferencing a
/// handle stops the program.
const FIRST: usize = usize::MAX / 9 * 4;

static NEXT: AtomicUsize = AtomicUsize::new(FIRST);

/// The live handles `*mut C` and their objects.
pub(crate) struct Handles<C, T> {
    what: &'static str,
    live: RwLock<BTreeMap<usize, T>>,
    kind: PhantomData<fn() -> C>,
}

impl<C, T: Clone> Handles<C, T> {
    pub(crate) const fn new(what: &'static str) -> Self {
        Self {
            what,
            live: RwLock::new(BTreeMap::new()),
            kind: PhantomData,
        }
    }

    /// Creates a handle of `value`.
    pub(crate) fn add(&self, value: T) -> *mut C {
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let mut live = self.live.write().unwrap_or_else(PoisonError::into_inner);
        live.insert(number, value);
        without_provenance_mut(number)
    }

    /// Returns a clone of a handle's object, which remains valid if the handle is freed.
    pub(crate) fn get(&self, handle: *const C) -> Result<T> {
        if handle.is_null() {
            return Err(Error::null(self.what));
        }
        let live = self.live.read().unwrap_or_else(PoisonError::into_inner);
        let value = live.get(&handle.addr());
        value.cloned().ok_or_else(|| Error::handle(self.what))
    }

    /// Frees a handle; null is ignored.
    pub(crate) fn free(&self, handle: *const C) -> Result<()> {
        if handle.is_null() {
            return Ok(());
        }
        let mut live = self.live.write().unwrap_or_else(PoisonError::into_inner);
        let value = live.remove(&handle.addr());
        // Dropping the object may take a while.
        drop(live);
        value.map(drop).ok_or_else(|| Error::handle(self.what))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn freed_foreign_and_null_handles_are_found_out() {
        let (words, numbers) = (
            Handles::<u8, _>::new("word"),
            Handles::<u16, _>::new("number"),
        );
        let (word, number) = (words.add("one"), numbers.add(1));
        assert_eq!(
            (words.get(word).unwrap(), numbers.get(number).unwrap()),
            ("one", 1)
        );
        assert!(words.get(number.cast()).is_err());
        assert!(words.get(std::ptr::null()).is_err());
        assert!(words.free(number.cast()).is_err());
        words.free(std::ptr::null()).unwrap();
        words.free(word).unwrap();
        assert!(words.get(word).is_err() && words.free(word).is_err());
        assert_ne!(words.add("two"), word);
    }
}
