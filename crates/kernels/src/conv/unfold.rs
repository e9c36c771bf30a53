//! Convolution as products of unfolded pixels (im2col), for strided convolutions and kernels of one tap.
//!
//! Work is divided and summed in the same way for any number of threads.

use super::shape::Shape;
use crate::schedule::InTasks;
use crate::simd::{
    Kernel, Level, Packed, Rows, Scratch, Shared, Tail, Unset, Vector, product, written,
};
use rayon::prelude::*;
use std::ops::Range;

/// Output pixels per task.
const PIXELS: usize = 84;

impl Shape {
    /// Returns image, row and column of output pixels, starting at `first`.
    fn pixels(&self, first: usize) -> impl Iterator<Item = [usize; 3]> + use<> {
        let (height, width) = self.out();
        let start = [
            first / width / height,
            first / width % height,
            first % width,
        ];
        std::iter::successors(Some(start), move |&[image, y, x]| {
            Some(if x + 1 < width {
                [image, y, x + 1]
            } else if y + 1 < height {
                [image, y + 1, 0]
            } else {
                [image + 1, 0, 0]
            })
        })
    }

    /// Calls `visit(columns, source)` for runs of the unfolded row of an output pixel, with the start of the run in the input
    /// if it is inside. Adjacent taps are merged into one run.
    fn runs_of(
        &self,
        [image, y, x]: [usize; 3],
        mut visit: impl FnMut(Range<usize>, Option<usize>),
    ) {
        let Shape { taps, spec, .. } = *self;
        let place = |i: usize, tap: usize, length: usize| {
            let place = (i * spec.stride + tap * spec.dilation).checked_sub(spec.padding);
            place.filter(|p| *p < length)
        };
        for ky in 0..taps {
            let row = place(y, ky, self.height);
            let mut run = |kx: Range<usize>, column: Option<usize>| {
                let source = row.zip(column).map(|(row, column)| {
                    ((image * self.height + row) * self.width + column) * self.channels
                });
                let first = ky * taps;
                visit(
                    (first + kx.start) * self.channels..(first + kx.end) * self.channels,
                    source,
                );
            };
            if spec.dilation == 1 {
                let start = x * spec.stride;
                let low = spec.padding.saturating_sub(start).min(taps);
                let high = (self.width + spec.padding).saturating_sub(start);
                let high = high.clamp(low, taps);
                run(0..low, None);
                run(low..high, (start + low).checked_sub(spec.padding));
                run(high..taps, None);
            } else {
                for kx in 0..taps {
                    run(kx..kx + 1, place(x, kx, self.width));
                }
            }
        }
    }

    /// Writes the unfolded rows `[pixels, depth]` of output pixels, starting at `first`.
    fn unfold(&self, x: &[f32], first: usize, rows: &mut [f32]) {
        for (pixel, row) in self.pixels(first).zip(rows.chunks_exact_mut(self.depth())) {
            self.runs_of(pixel, |columns, source| {
                let to = &mut row[columns];
                match source {
                    Some(source) => to.copy_from_slice(&x[source..source + to.len()]),
                    None => to.fill(0.0),
                }
            });
        }
    }

    /// Adds unfolded rows to the input: the adjoint of `unfold`.
    fn fold(&self, rows: &[f32], first: usize, x: &mut [f32]) {
        for (pixel, row) in self.pixels(first).zip(rows.chunks_exact(self.depth())) {
            self.runs_of(pixel, |columns, source| {
                if let Some(source) = source {
                    let from = &row[columns];
                    let to = &mut x[source..source + from.len()];
                    to.iter_mut().zip(from).for_each(|(t, v)| *t += v);
                }
            });
        }
    }
}

/// Computes the convolution with weights `[depth, outputs]`; sets every float of the output.
pub(super) fn forward(
    x: &[f32],
    weights: &Packed,
    shape: &Shape,
    tail: Tail<'_>,
    scratch: &Scratch,
    output: &mut Unset,
) {
    if shape.is_pointwise() {
        return weights.write_parallel(x, tail, output);
    }
    let (depth, piece) = (shape.depth(), PIXELS * shape.outputs.max(1));
    let outputs = output.par_chunks_mut(piece).enumerate();
    outputs.each(|(i, output)| {
        let pixels = output.len() / shape.outputs;
        scratch.with(pixels * depth, |rows| {
            shape.unfold(x, i * PIXELS, rows);
            let skip = tail.skip.map(|skip| &skip[i * piece..][..output.len()]);
            weights.write(rows, Tail { skip, ..tail }, output);
        });
    });
}

/// Returns the gradient of the input, given the transposed weights `[outputs, depth]`.
pub(super) fn input_gradient(
    grad: &[f32],
    transposed: &Packed,
    shape: &Shape,
    scratch: &Scratch,
) -> Vec<f32> {
    let image = shape.height * shape.width * shape.channels;
    if shape.is_pointwise() {
        let write = |x: &mut Unset| transposed.write_parallel(grad, Tail::default(), x);
        // SAFETY: `write_parallel` sets every float.
        return unsafe { written(shape.input_len(), write) };
    }
    let mut x = vec![0.0; shape.input_len()];
    let pixels = shape.out().0 * shape.out().1;
    // Neighbouring outputs share inputs, so a whole image is one task.
    x.par_chunks_mut(image.max(1))
        .enumerate()
        .for_each(|(b, image)| {
            let one = Shape { batch: 1, ..*shape };
            for first in (0..pixels).step_by(PIXELS) {
                let count = PIXELS.min(pixels - first);
                let grad = &grad[(b * pixels + first) * shape.outputs..][..count * shape.outputs];
                scratch.with(count * shape.depth(), |rows| {
                    transposed.apply(grad, Tail::default(), rows);
                    one.fold(rows, first, image);
                });
            }
        });
    x
}

/// Largest number of parallel partial sums.
const PARTS: usize = 8;
/// Pixels per block of products added to a sum: a panel of their gradients fits first-level caches.
const BLOCK: usize = 84;

/// Returns the gradient of the weights, `[depth, outputs]`.
pub(super) fn weight_gradient(
    level: Level,
    x: &[f32],
    grad: &[f32],
    shape: &Shape,
    scratch: &Scratch,
) -> Vec<f32> {
    let (depth, outputs) = (shape.depth(), shape.outputs);
    let pixels = shape.out_pixels();
    let width = level.panel(outputs);
    let padded = outputs.next_multiple_of(width);
    // A convolution with one tap reads its rows from the input, and whole panels need no padding.
    let unfolded = if shape.is_pointwise() { 0 } else { depth };
    let padding = if padded == outputs { 0 } else { padded };
    let part = pixels.div_ceil(PARTS).next_multiple_of(BLOCK);
    let starts: Vec<usize> = (0..pixels).step_by(part.max(1)).collect();
    let sums: Vec<Vec<f32>> = starts
        .par_iter()
        .map(|&start| {
            let mut sum = vec![0.0; depth * padded];
            let end = (start + part).min(pixels);
            for first in (start..end).step_by(BLOCK) {
                let count = BLOCK.min(end - first);
                scratch.with(count * (unfolded + padding), |memory| {
                    let (padded_grads, rows) = memory.split_at_mut(count * padding);
                    let rows = if shape.is_pointwise() {
                        &x[first * depth..][..count * depth]
                    } else {
                        shape.unfold(x, first, rows);
                        rows
                    };
                    let grads = &grad[first * outputs..][..count * outputs];
                    let grads = if padding == 0 {
                        grads
                    } else {
                        pad(grads, outputs, padded_grads, padded);
                        padded_grads
                    };
                    let kernel = Correlate {
                        rows,
                        grads,
                        depth,
                        padded,
                        width,
                        count,
                        sum: Shared::new(&mut sum),
                    };
                    // SAFETY: the memory has the lengths that the kernel relies on.
                    unsafe { level.run(kernel) }
                });
            }
            sum
        })
        .collect();
    let mut total = vec![0.0; depth * outputs];
    for sum in &sums {
        for (total, sum) in total
            .chunks_exact_mut(outputs)
            .zip(sum.chunks_exact(padded))
        {
            total.iter_mut().zip(sum).for_each(|(t, s)| *t += s);
        }
    }
    total
}

/// Pads rows of `columns` with zeros.
fn pad(rows: &[f32], columns: usize, padded: &mut [f32], width: usize) {
    let rows = rows.chunks_exact(columns.max(1));
    for (to, row) in padded.chunks_exact_mut(width).zip(rows) {
        to[..columns].copy_from_slice(row);
        to[columns..].fill(0.0);
    }
}

/// Adds `rows^T [depth, count] * grads [count, padded]`.
struct Correlate<'a> {
    rows: &'a [f32],
    grads: &'a [f32],
    depth: usize,
    padded: usize,
    /// Width of a panel.
    width: usize,
    count: usize,
    sum: Shared<'a>,
}

impl Kernel for Correlate<'_> {
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        // SAFETY: as demanded from the caller.
        unsafe {
            if self.width == V::LANES {
                self.add::<V, 1>();
            } else {
                self.add::<V, 2>();
            }
        }
    }
}

impl Correlate<'_> {
    /// Adds the products with panels of `W` vectors.
    ///
    /// # Safety
    /// As for `Vector`; rows, gradients and the sum have the lengths given by the fields.
    #[inline(always)]
    unsafe fn add<V: Vector, const W: usize>(self) {
        let rows = Rows {
            pointer: self.rows.as_ptr(),
            row: 1,
            step: self.depth,
        };
        for first in (0..self.padded).step_by(W * V::LANES) {
            // SAFETY: as demanded from the caller.
            unsafe {
                product::<V, W>(
                    rows,
                    self.depth,
                    self.count,
                    self.grads.as_ptr().add(first),
                    self.padded,
                    #[inline(always)]
                    |k, sums| {
                        let to = self.sum.at(k * self.padded + first, W * V::LANES);
                        for (i, &sum) in sums.iter().enumerate() {
                            let to = to.add(i * V::LANES);
                            V::load(to).add(sum).store(to);
                        }
                    },
                );
            }
        }
    }
}
