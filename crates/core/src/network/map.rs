//! Feature maps passed between layers, and their reusable memory.

use crate::bilinear::neighbours;
use lsdc_kernels::schedule::InTasks;
use lsdc_kernels::simd::{Buffer, Level};
use rayon::prelude::*;
use std::sync::{Arc, Mutex};

/// Values `[height, width, channels]`; the memory returns to its pool when the map is dropped.
#[derive(Debug, Default)]
pub(super) struct Map {
    pub(super) values: Buffer,
    pub(super) height: usize,
    pub(super) width: usize,
    pub(super) pool: Pool,
}

impl Drop for Map {
    fn drop(&mut self) {
        self.pool.give(std::mem::take(&mut self.values));
    }
}

impl Map {
    pub(super) fn pixels(&self) -> usize {
        self.height * self.width
    }

    pub(super) fn channels(&self) -> usize {
        self.values.len() / self.pixels().max(1)
    }

    pub(super) fn copied(&self) -> Self {
        let channels = self.channels();
        self.pool
            .copy(&self.values, self.height, self.width, channels)
    }

    /// Upsamples the map bilinearly to a height and width.
    pub(super) fn enlarged(&self, height: usize, width: usize) -> Self {
        let mut enlarged = self.pool.take(height, width, self.channels());
        enlarged.values.fill(0.0);
        enlarged.add_enlarged(self);
        enlarged
    }

    /// Returns the value at pixel (y, x) of the map upsampled bilinearly to a height and width.
    #[inline(always)]
    pub(super) fn enlarged_pixel(
        &self,
        (y, height): (usize, usize),
        (x, width): (usize, usize),
        output: &mut [f32],
    ) {
        let (top, bottom, v) = neighbours(y as f64, height, self.height);
        let (left, right, u) = neighbours(x as f64, width, self.width);
        let (u, v) = (u as f32, v as f32);
        let pixel = |y: usize, x: usize| &self.values[(y * self.width + x) * output.len()..];
        let upper = pixel(top, left).iter().zip(pixel(top, right));
        let lower = pixel(bottom, left).iter().zip(pixel(bottom, right));
        for (output, (a, b)) in output.iter_mut().zip(upper.zip(lower)) {
            let upper = a.0 * (1.0 - u) + a.1 * u;
            let lower = b.0 * (1.0 - u) + b.1 * u;
            *output = upper * (1.0 - v) + lower * v;
        }
    }

    /// Adds a map with the same channels, upsampled bilinearly.
    pub(super) fn add_enlarged(&mut self, map: &Self) {
        let (height, width, channels) = (self.height, self.width, self.channels());
        let level = Level::here();
        let rows = self.values.par_chunks_exact_mut(width * channels);
        rows.enumerate().each(|(y, row)| {
            let mut value = vec![0.0; channels];
            level.vectorised(
                #[inline(always)]
                || {
                    for (x, pixel) in row.chunks_exact_mut(channels).enumerate() {
                        map.enlarged_pixel((y, height), (x, width), &mut value);
                        pixel.iter_mut().zip(&value).for_each(|(p, v)| *p += v);
                    }
                },
            );
        });
    }
}

/// Memory of dropped maps for reuse: allocating fresh pages takes as long as a layer. Clones share it.
#[derive(Clone, Debug, Default)]
pub(super) struct Pool(Arc<Mutex<Vec<Buffer>>>);

/// Largest number of free buffers in a pool: as many as are in use at once.
const CAPACITY: usize = 8;

impl Pool {
    /// Returns a map with arbitrary values.
    pub(super) fn take(&self, height: usize, width: usize, channels: usize) -> Map {
        let length = height * width * channels;
        let mut values = self.find(length).unwrap_or_default();
        values.reshape(length);
        Map {
            values,
            height,
            width,
            pool: self.clone(),
        }
    }

    /// Returns a map with these values.
    pub(super) fn copy(&self, values: &[f32], height: usize, width: usize, channels: usize) -> Map {
        let mut map = self.take(height, width, channels);
        map.values.copy_from_slice(values);
        map
    }

    /// Returns the shortest buffer that is long enough.
    fn find(&self, length: usize) -> Option<Buffer> {
        let mut free = self.0.lock().ok()?;
        let fitting = free
            .iter()
            .enumerate()
            .filter(|(_, v)| v.capacity() >= length);
        let (place, _) = fitting.min_by_key(|(_, v)| v.capacity())?;
        Some(free.swap_remove(place))
    }

    /// Frees all buffers.
    pub(super) fn clear(&self) {
        if let Ok(mut free) = self.0.lock() {
            free.clear();
        }
    }

    /// Returns a buffer to the pool; if there are more than [`CAPACITY`] buffers, the smallest is freed.
    fn give(&self, values: Buffer) {
        if let Ok(mut free) = self.0.lock() {
            free.push(values);
            if free.len() > CAPACITY {
                let smallest = (0..free.len()).min_by_key(|&i| free[i].capacity());
                smallest.map(|i| free.swap_remove(i));
            }
        }
    }
}
