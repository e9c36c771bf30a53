//! Memory that threads reuse, and memory that they share.

use std::marker::PhantomData;
use std::mem::MaybeUninit;
use std::ops::{Deref, DerefMut};
use std::sync::Mutex;

/// Floats that start at a cache line, so that no aligned vector straddles two.
#[derive(Clone, Debug, Default)]
pub struct Buffer {
    lines: Vec<Line>,
    length: usize,
}

#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct Line([f32; 16]);

impl Buffer {
    /// `length` zeros.
    pub fn zeros(length: usize) -> Self {
        Self {
            lines: vec![Line([0.0; 16]); length.div_ceil(16)],
            length,
        }
    }

    /// Floats that fit without new memory.
    pub fn capacity(&self) -> usize {
        16 * self.lines.len()
    }

    /// Changes the length; the values are then unspecified.
    pub fn reshape(&mut self, length: usize) {
        if length > self.capacity() {
            *self = Self::zeros(length);
        }
        self.length = length;
    }
}

impl Deref for Buffer {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        // SAFETY: lines are arrays of floats without gaps, and hold at least `length`.
        unsafe { std::slice::from_raw_parts(self.lines.as_ptr().cast(), self.length) }
    }
}

impl DerefMut for Buffer {
    fn deref_mut(&mut self) -> &mut [f32] {
        // SAFETY: as above.
        unsafe { std::slice::from_raw_parts_mut(self.lines.as_mut_ptr().cast(), self.length) }
    }
}

/// Memory that is written before it is read: to clear it first would cost as much as a layer.
pub(crate) type Unset = [MaybeUninit<f32>];

/// A vector of `length` floats, which `write` sets.
///
/// # Safety
/// `write` must set every float.
pub(crate) unsafe fn written(length: usize, write: impl FnOnce(&mut Unset)) -> Vec<f32> {
    let mut values = Vec::with_capacity(length);
    write(&mut values.spare_capacity_mut()[..length]);
    // SAFETY: they have been set, as demanded from the caller.
    unsafe { values.set_len(length) };
    values
}

/// Floats as memory to be written.
///
/// # Safety
/// Nothing but floats may be written there.
pub(crate) unsafe fn unset(values: &mut [f32]) -> &mut Unset {
    // SAFETY: both have the same form; the rest is demanded from the caller.
    unsafe { &mut *(std::ptr::from_mut(values) as *mut Unset) }
}

/// Working memory of each thread, kept from call to call.
#[derive(Debug)]
pub struct Scratch {
    /// For the thread that runs an operation, which may share it with others.
    whole: Mutex<Buffer>,
    /// For threads outside of the pool, and for each thread of the pool.
    slots: Vec<Mutex<Buffer>>,
}

impl Default for Scratch {
    fn default() -> Self {
        Self::new()
    }
}

impl Scratch {
    /// No memory yet; it grows to what the largest operation needs.
    pub fn new() -> Self {
        let slots = (0..=rayon::current_num_threads()).map(|_| Mutex::default());
        Self {
            whole: Mutex::default(),
            slots: slots.collect(),
        }
    }

    /// Calls `f` with `length` floats of unspecified values, for this thread.
    pub fn with<R>(&self, length: usize, f: impl FnOnce(&mut [f32]) -> R) -> R {
        let slot = rayon::current_thread_index().map_or(0, |i| i + 1);
        Self::lend(self.slots.get(slot), length, f)
    }

    /// Calls `f` with `length` floats of unspecified values, which it may share with other threads.
    pub(crate) fn with_whole<R>(&self, length: usize, f: impl FnOnce(&mut [f32]) -> R) -> R {
        Self::lend(Some(&self.whole), length, f)
    }

    /// Frees the memory that is not in use.
    pub fn clear(&self) {
        for slot in self.slots.iter().chain([&self.whole]) {
            if let Ok(mut memory) = slot.try_lock() {
                *memory = Buffer::default();
            }
        }
    }

    fn lend<R>(slot: Option<&Mutex<Buffer>>, length: usize, f: impl FnOnce(&mut [f32]) -> R) -> R {
        // In use only if a thread stole work during its own, or if two threads outside of the pool
        // compute at once: rare.
        let Some(Ok(mut memory)) = slot.map(Mutex::try_lock) else {
            return f(&mut Buffer::zeros(length));
        };
        memory.reshape(length);
        f(&mut memory)
    }
}

/// A slice of which several tasks write different parts.
#[derive(Clone, Copy)]
pub(crate) struct Shared<'a> {
    pointer: *mut f32,
    length: usize,
    _borrow: PhantomData<&'a mut [f32]>,
}

// SAFETY: whoever calls `at` promises that no two tasks touch the same floats.
unsafe impl Send for Shared<'_> {}
// SAFETY: as above.
unsafe impl Sync for Shared<'_> {}

impl<'a> Shared<'a> {
    pub(crate) fn new(values: &'a mut [f32]) -> Self {
        // SAFETY: the pointer is only handed out as one to floats.
        Self::unset(unsafe { unset(values) })
    }

    pub(crate) fn unset(values: &'a mut Unset) -> Self {
        Self {
            pointer: values.as_mut_ptr().cast(),
            length: values.len(),
            _borrow: PhantomData,
        }
    }

    /// A pointer to `length` floats from `start` on.
    ///
    /// # Safety
    /// They lie inside the slice, and no other task uses them.
    #[inline(always)]
    pub(crate) unsafe fn at(self, start: usize, length: usize) -> *mut f32 {
        debug_assert!(start + length <= self.length);
        // SAFETY: as demanded from the caller.
        unsafe { self.pointer.add(start) }
    }
}
