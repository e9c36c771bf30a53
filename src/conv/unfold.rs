//! Convolution as products of unfolded pixels (im2col): strides, and kernels of one tap.
//!
//! Work is cut into the same pieces and summed in the same order whatever the number of threads.

use super::shape::Shape;
use crate::simd::{Kernel, Level, Packed, Rows, Scratch, Shared, Tail, Vector, product};
use rayon::prelude::*;

/// Output pixels of one task.
const PIXELS: usize = 84;

impl Shape {
    /// Calls `visit(column, source)` for every tap of output pixel `pixel`: the first of its
    /// `channels` columns in the unfolded row, and of its floats in the input, if inside.
    fn taps_of(&self, pixel: usize, mut visit: impl FnMut(usize, Option<usize>)) {
        let (out_height, out_width) = self.out();
        let (image, y, x) = (
            pixel / out_width / out_height,
            pixel / out_width % out_height,
            pixel % out_width,
        );
        let spec = self.spec;
        let place = |i: usize, tap: usize, length: usize| {
            let place = (i * spec.stride + tap * spec.dilation).checked_sub(spec.padding);
            place.filter(|p| *p < length)
        };
        for ky in 0..self.taps {
            let row = place(y, ky, self.height);
            for kx in 0..self.taps {
                let source = row.zip(place(x, kx, self.width)).map(|(row, column)| {
                    ((image * self.height + row) * self.width + column) * self.channels
                });
                visit((ky * self.taps + kx) * self.channels, source);
            }
        }
    }

    /// The unfolded rows `[pixels, depth]` of output pixels from `first` on.
    fn unfold(&self, x: &[f32], first: usize, rows: &mut [f32]) {
        for (i, row) in rows.chunks_exact_mut(self.depth()).enumerate() {
            self.taps_of(first + i, |column, source| {
                let to = &mut row[column..column + self.channels];
                match source {
                    Some(source) => to.copy_from_slice(&x[source..source + self.channels]),
                    None => to.fill(0.0),
                }
            });
        }
    }

    /// Adds unfolded rows back onto the input: the adjoint of `unfold`.
    fn fold(&self, rows: &[f32], first: usize, x: &mut [f32]) {
        for (i, row) in rows.chunks_exact(self.depth()).enumerate() {
            self.taps_of(first + i, |column, source| {
                if let Some(source) = source {
                    let to = &mut x[source..source + self.channels];
                    let from = &row[column..column + self.channels];
                    to.iter_mut().zip(from).for_each(|(t, v)| *t += v);
                }
            });
        }
    }
}

/// The convolution with weights `[depth, outputs]`.
pub(super) fn forward(
    x: &[f32],
    weights: &Packed,
    shape: &Shape,
    tail: Tail<'_>,
    scratch: &Scratch,
    output: &mut [f32],
) {
    if shape.is_pointwise() {
        return weights.apply_parallel(x, tail, output);
    }
    let (depth, piece) = (shape.depth(), PIXELS * shape.outputs.max(1));
    let outputs = output.par_chunks_mut(piece).enumerate();
    outputs.for_each(|(i, output)| {
        let pixels = output.len() / shape.outputs;
        scratch.with(pixels * depth, |rows| {
            shape.unfold(x, i * PIXELS, rows);
            let skip = tail.skip.map(|skip| &skip[i * piece..][..output.len()]);
            weights.apply(rows, Tail { skip, ..tail }, output);
        });
    });
}

/// The gradient of the input, with the transposed weights `[outputs, depth]`.
pub(super) fn input_gradient(
    grad: &[f32],
    transposed: &Packed,
    shape: &Shape,
    scratch: &Scratch,
) -> Vec<f32> {
    let image = shape.height * shape.width * shape.channels;
    let mut x = vec![0.0; shape.batch * image];
    if shape.is_pointwise() {
        transposed.apply_parallel(grad, Tail::default(), &mut x);
        return x;
    }
    let pixels = shape.out().0 * shape.out().1;
    // Neighbouring outputs share inputs, so that a whole image is one task.
    x.par_chunks_mut(image.max(1))
        .enumerate()
        .for_each(|(b, image)| {
            let alone = Shape { batch: 1, ..*shape };
            for first in (0..pixels).step_by(PIXELS) {
                let count = PIXELS.min(pixels - first);
                let grad = &grad[(b * pixels + first) * shape.outputs..][..count * shape.outputs];
                scratch.with(count * shape.depth(), |rows| {
                    transposed.apply(grad, Tail::default(), rows);
                    alone.fold(rows, first, image);
                });
            }
        });
    x
}

/// Sums that run side by side, at most.
const PARTS: usize = 8;

/// The gradient of the weights, `[depth, outputs]`.
pub(super) fn weight_gradient(
    level: Level,
    x: &[f32],
    grad: &[f32],
    shape: &Shape,
    scratch: &Scratch,
) -> Vec<f32> {
    let (depth, outputs) = (shape.depth(), shape.outputs);
    let pixels = shape.out_pixels();
    let padded = outputs.next_multiple_of(2 * level.lanes());
    let part = pixels.div_ceil(PARTS).next_multiple_of(PIXELS);
    let starts: Vec<usize> = (0..pixels).step_by(part.max(1)).collect();
    let sums: Vec<Vec<f32>> = starts
        .par_iter()
        .map(|&start| {
            let mut sum = vec![0.0; depth * padded];
            for first in (start..(start + part).min(pixels)).step_by(PIXELS) {
                let count = PIXELS.min((start + part).min(pixels) - first);
                scratch.with(count * (depth + padded), |memory| {
                    let (rows, grads) = memory.split_at_mut(count * depth);
                    shape.unfold(x, first, rows);
                    let grad = grad[first * outputs..].chunks_exact(outputs);
                    for (to, from) in grads.chunks_exact_mut(padded).zip(grad) {
                        to[..outputs].copy_from_slice(from);
                        to[outputs..].fill(0.0);
                    }
                    let kernel = Correlate {
                        rows,
                        grads,
                        depth,
                        padded,
                        count,
                        sum: Shared::new(&mut sum),
                    };
                    // SAFETY: the memory was cut to the lengths that the kernel relies on.
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

/// Adds `rows^T [depth, count] * grads [count, padded]`.
struct Correlate<'a> {
    rows: &'a [f32],
    grads: &'a [f32],
    depth: usize,
    padded: usize,
    count: usize,
    sum: Shared<'a>,
}

impl Kernel for Correlate<'_> {
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        let rows = Rows {
            pointer: self.rows.as_ptr(),
            row: 1,
            step: self.depth,
        };
        for first in (0..self.padded).step_by(2 * V::LANES) {
            // SAFETY: as the caller made the memory.
            unsafe {
                let grads = self.grads.as_ptr().add(first);
                product::<V>(
                    rows,
                    self.depth,
                    self.count,
                    grads,
                    self.padded,
                    |k, sums| {
                        let to = self.sum.at(k * self.padded + first, 2 * V::LANES);
                        let right = to.add(V::LANES);
                        V::load(to).add(sums[0]).store(to);
                        V::load(right).add(sums[1]).store(right);
                    },
                );
            }
        }
    }
}
