//! Memory that threads reuse, and memory that tasks write in parallel.

use std::marker::PhantomData;
use std::mem::MaybeUninit;
use std::ops::{Deref, DerefMut};
use std::sync::Mutex;

/// Floats aligned to cache lines, so that no aligned vector crosses a line.
#[derive(Clone, Debug, Default)]
pub struct Buffer {
    lines: Vec<Line>,
    length: usize,
}

#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct Line([f32; 16]);

impl Buffer {
    /// Returns a buffer of `length` zeros.
    pub fn zeros(length: usize) -> Self {
        Self {
            lines: vec![Line([0.0; 16]); length.div_ceil(16)],
            length,
        }
    }

    /// Number of floats that fit without a new allocation.
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

/// Memory that is written before it is read: clearing it first would take as long as a layer.
pub(crate) type Unset = [MaybeUninit<f32>];

/// Returns a vector of `length` floats, which `write` sets.
///
/// # Safety
/// `write` must set every float.
pub(crate) unsafe fn written(length: usize, write: impl FnOnce(&mut Unset)) -> Vec<f32> {
    let mut values = Vec::with_capacity(length);
    write(&mut values.spare_capacity_mut()[..length]);
    // SAFETY: all floats have been set, as required from the caller.
    unsafe { values.set_len(length) };
    values
}

/// Returns floats as memory to be written.
///
/// # Safety
/// The caller must write only floats to it.
pub(crate) unsafe fn unset(values: &mut [f32]) -> &mut Unset {
    // SAFETY: both types have the same layout; the caller meets the other requirement.
    unsafe { &mut *(std::ptr::from_mut(values) as *mut Unset) }
}

/// Reusable working memory of each thread.
#[derive(Debug)]
pub struct Scratch {
    /// For the thread that runs an operation, and may share the memory with others.
    whole: Mutex<Buffer>,
    /// One for threads outside the pool, and one for each thread of the pool.
    slots: Vec<Mutex<Buffer>>,
}

impl Default for Scratch {
    fn default() -> Self {
        Self::new()
    }
}

impl Scratch {
    /// Starts without memory; it grows to the size needed by the largest operation.
    pub fn new() -> Self {
        let slots = (0..=rayon::current_num_threads()).map(|_| Mutex::default());
        Self {
            whole: Mutex::default(),
            slots: slots.collect(),
        }
    }

    /// Calls `f` with `length` floats of unspecified values, reserved for this thread.
    pub fn with<R>(&self, length: usize, f: impl FnOnce(&mut [f32]) -> R) -> R {
        let slot = rayon::current_thread_index().map_or(0, |i| i + 1);
        Self::lend(self.slots.get(slot), length, f)
    }

    /// Calls `f` with `length` floats of unspecified values, which `f` may share with other threads.
    pub(crate) fn with_whole<R>(&self, length: usize, f: impl FnOnce(&mut [f32]) -> R) -> R {
        Self::lend(Some(&self.whole), length, f)
    }

    /// Frees the unused memory.
    pub fn clear(&self) {
        for slot in self.slots.iter().chain([&self.whole]) {
            if let Ok(mut memory) = slot.try_lock() {
                *memory = Buffer::default();
            }
        }
    }

    fn lend<R>(slot: Option<&Mutex<Buffer>>, length: usize, f: impl FnOnce(&mut [f32]) -> R) -> R {
        // In use only if a thread stole work while it held the memory, or if two threads outside the pool compute at once:
        // rare.
        let Some(Ok(mut memory)) = slot.map(Mutex::try_lock) else {
            return f(&mut Buffer::zeros(length));
        };
        memory.reshape(length);
        f(&mut memory)
    }
}

/// A slice whose parts are written by several tasks.
#[derive(Clone, Copy)]
pub(crate) struct Shared<'a> {
    pointer: *mut f32,
    length: usize,
    _borrow: PhantomData<&'a mut [f32]>,
}

// SAFETY: callers of `at` guarantee that no two tasks access the same floats.
unsafe impl Send for Shared<'_> {}
// SAFETY: as above.
unsafe impl Sync for Shared<'_> {}

impl<'a> Shared<'a> {
    pub(crate) fn new(values: &'a mut [f32]) -> Self {
        // SAFETY: the pointer is only used to write floats.
        Self::unset(unsafe { unset(values) })
    }

    pub(crate) fn unset(values: &'a mut Unset) -> Self {
        Self {
            pointer: values.as_mut_ptr().cast(),
            length: values.len(),
            _borrow: PhantomData,
        }
    }

    /// Returns a pointer to `length` floats, starting at `start`.
    ///
    /// # Safety
    /// The floats must be inside the slice, and no other task may use them.
    #[inline(always)]
    pub(crate) unsafe fn at(self, start: usize, length: usize) -> *mut f32 {
        debug_assert!(start + length <= self.length);
        // SAFETY: as demanded from the caller.
        unsafe { self.pointer.add(start) }
    }
}
