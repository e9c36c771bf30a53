//! Handles: numbers that look like pointers, and the tables of what they stand for.
//!
//! A number is given out once. Hence a handle that was freed, twice or while another thread uses it, and one
//! that was never made, are found out; none is ever followed.

use crate::error::{Error, Result};
use std::collections::BTreeMap;
use std::marker::PhantomData;
use std::ptr::without_provenance_mut;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{PoisonError, RwLock};

/// No address of x86-64 or AArch64 begins like this, so that a pointer of the caller is not taken for a
/// handle, and a handle that is followed stops the program.
const FIRST: usize = usize::MAX / 9 * 4;

static NEXT: AtomicUsize = AtomicUsize::new(FIRST);

/// The live handles `*mut C`, and what they stand for.
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

    /// A new handle of `value`.
    pub(crate) fn add(&self, value: T) -> *mut C {
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let mut live = self.live.write().unwrap_or_else(PoisonError::into_inner);
        live.insert(number, value);
        without_provenance_mut(number)
    }

    /// What a handle stands for: a share of it, which lives on if the handle is freed.
    pub(crate) fn get(&self, handle: *const C) -> Result<T> {
        if handle.is_null() {
            return Err(Error::null(self.what));
        }
        let live = self.live.read().unwrap_or_else(PoisonError::into_inner);
        let value = live.get(&handle.addr());
        value.cloned().ok_or_else(|| Error::handle(self.what))
    }

    /// Frees a handle; null is none.
    pub(crate) fn free(&self, handle: *const C) -> Result<()> {
        if handle.is_null() {
            return Ok(());
        }
        let mut live = self.live.write().unwrap_or_else(PoisonError::into_inner);
        let value = live.remove(&handle.addr());
        // What it stands for may take a while to go.
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
