//! A pool of buffers.

use std::ops::Deref;
use std::sync::{Arc, Mutex, PoisonError};
use wgpu::{Buffer, BufferDescriptor, BufferUsages, Device};

/// Freed buffers of any use. Clones share them.
#[derive(Clone, Debug, Default)]
pub(crate) struct Pool(Arc<Mutex<Vec<Buffer>>>);

/// Limit of free buffers: as many as a few scenes use at once.
const CAPACITY: usize = 16;

impl Pool {
    /// Returns a buffer of at least this size, with arbitrary contents.
    pub(crate) fn take(&self, device: &Device, bytes: u64, usage: BufferUsages) -> Pooled {
        // Sizes are rounded up, so that varying numbers of points reuse buffers.
        let size = bytes.max(256).next_power_of_two();
        let found = {
            let mut free = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            let place = (free.iter()).position(|b| b.size() == size && b.usage() == usage);
            place.map(|place| free.swap_remove(place))
        };
        let buffer = found.unwrap_or_else(|| {
            device.create_buffer(&BufferDescriptor {
                label: None,
                size,
                usage,
                mapped_at_creation: false,
            })
        });
        Pooled {
            buffer,
            pool: self.clone(),
        }
    }

    /// Frees all buffers.
    pub(crate) fn clear(&self) {
        self.0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clear();
    }
}

/// A buffer that returns to its pool.
#[derive(Debug)]
pub(crate) struct Pooled {
    buffer: Buffer,
    pool: Pool,
}

impl Deref for Pooled {
    type Target = Buffer;

    fn deref(&self) -> &Buffer {
        &self.buffer
    }
}

impl Drop for Pooled {
    fn drop(&mut self) {
        let mut free = self.pool.0.lock().unwrap_or_else(PoisonError::into_inner);
        if free.len() == CAPACITY {
            free.remove(0);
        }
        free.push(self.buffer.clone());
    }
}
