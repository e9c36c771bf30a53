//! Depthwise convolution and its gradients, as plain sums over the taps: there are so few products per value that memory is the
//! bottleneck.
//!
//! Work is divided and summed in the same way for any number of threads.

use super::layer::transposed;
use super::shape::Shape;
use crate::schedule::InTasks;
use crate::simd::{Kernel, Level, Shared, Tail, Unset, Vector, written};
use rayon::prelude::*;

/// Largest number of parallel partial sums of weight gradients.
const PARTS: usize = 8;
/// Positions of a line with the same taps that are summed together, so that each weight is loaded once for all of them.
const BLOCK: usize = 4;

/// Prepared weights, with a bias.
#[derive(Clone, Debug)]
pub(super) struct Filter {
    level: Level,
    /// `[taps * taps, channels]`
    weights: Vec<f32>,
    bias: Vec<f32>,
}

impl Filter {
    /// Prepares weights `[channels, 1, taps, taps]`; an empty bias is 0.
    pub(super) fn new(level: Level, weights: &[f32], channels: usize, bias: &[f32]) -> Self {
        let area = weights.len() / channels.max(1);
        let mut bias = bias.to_vec();
        bias.resize(channels, 0.0);
        Self {
            level,
            weights: transposed(weights, channels, area),
            bias,
        }
    }

    /// Computes `output [batch, height', width', channels]` from `x [batch, height, width, channels]`; sets every float.
    pub(super) fn write(&self, x: &[f32], shape: &Shape, tail: Tail<'_>, output: &mut Unset) {
        let from = [shape.height, shape.width];
        self.gather(x, from, shape, &AxisTaps::both(shape), tail, output);
    }

    /// Computes sums over the taps of rows and columns, for images of `from` rows and columns.
    fn gather(
        &self,
        x: &[f32],
        from: [usize; 2],
        shape: &Shape,
        [rows, columns]: &[AxisTaps; 2],
        tail: Tail<'_>,
        output: &mut Unset,
    ) {
        let channels = shape.channels;
        let length = columns.len() * channels;
        let images = from[0] * from[1] * channels;
        let lines = output.par_chunks_mut(length.max(1)).enumerate();
        lines.each(|(i, output)| {
            let skip = tail.skip.map(|skip| &skip[i * length..][..length]);
            let kernel = Gather {
                filter: self,
                x: &x[i / rows.len() * images..][..images],
                width: from[1],
                taps: shape.taps,
                rows: rows.of(i % rows.len()),
                columns,
                tail: Tail { skip, ..tail },
                output: Shared::unset(output),
            };
            // SAFETY: all slices have the lengths that the kernel relies on.
            unsafe { self.level.run(kernel) }
        });
    }
}

/// Returns the gradient of the input from that of the output, with weights `[channels, 1, taps, taps]`.
pub(super) fn input_gradient(
    level: Level,
    weights: &[f32],
    grad: &[f32],
    shape: &Shape,
) -> Vec<f32> {
    let from: [usize; 2] = shape.out().into();
    let [rows, columns] = AxisTaps::both(shape);
    let taps = [
        rows.transposed(shape.height),
        columns.transposed(shape.width),
    ];
    let filter = Filter::new(level, weights, shape.channels, &[]);
    let tail = Tail::default();
    let write = |x: &mut Unset| filter.gather(grad, from, shape, &taps, tail, x);
    // SAFETY: `gather` sets every float.
    unsafe { written(shape.input_len(), write) }
}

/// Returns the gradient of the weights `[channels, 1, taps, taps]` from that of the output.
pub(super) fn weight_gradient(level: Level, x: &[f32], grad: &[f32], shape: &Shape) -> Vec<f32> {
    let taps = AxisTaps::both(shape);
    let (channels, area) = (shape.channels, shape.taps * shape.taps);
    let rows = shape.batch * shape.out().0;
    let part = rows.div_ceil(PARTS).max(1);
    let starts: Vec<usize> = (0..rows).step_by(part).collect();
    let sum = |&start: &usize| {
        let mut sums = vec![0.0; area * channels];
        let kernel = Correlate {
            x,
            grad,
            shape,
            taps: &taps,
            lines: start..(start + part).min(rows),
            sums: Shared::new(&mut sums),
        };
        // SAFETY: all slices have the lengths that the kernel relies on.
        unsafe { level.run(kernel) };
        sums
    };
    let parts: Vec<Vec<f32>> = starts.par_iter().map(sum).collect();
    let mut total = vec![0.0; area * channels];
    for sums in parts {
        total.iter_mut().zip(sums).for_each(|(t, s)| *t += s);
    }
    transposed(&total, area, channels)
}

/// The taps inside the source, along one axis, and their positions in it, for each position of the result.
struct AxisTaps {
    /// Pairs of tap and position.
    pairs: Vec<(usize, usize)>,
    /// End of the pairs of each position.
    ends: Vec<usize>,
    /// For each position, whether all positions of the [`BLOCK`] that begins there have the same taps.
    same_taps: Vec<bool>,
}

impl AxisTaps {
    /// Returns the taps of rows and of columns.
    fn both(shape: &Shape) -> [Self; 2] {
        let (height, width) = shape.out();
        [
            Self::new(shape, shape.height, height),
            Self::new(shape, shape.width, width),
        ]
    }

    /// Lists the taps for `to` outputs of an input of length `from`.
    fn new(shape: &Shape, from: usize, to: usize) -> Self {
        let spec = shape.spec;
        let of = |i: usize| {
            let place =
                |tap: usize| (i * spec.stride + tap * spec.dilation).checked_sub(spec.padding);
            let inside = |tap| Some((tap, place(tap).filter(|p| *p < from)?));
            (0..shape.taps).filter_map(inside).collect()
        };
        Self::of_lists((0..to).map(of).collect())
    }

    /// Lists, for `to` inputs, the positions in the outputs.
    fn transposed(&self, to: usize) -> Self {
        let mut lists = vec![vec![]; to];
        for i in 0..self.len() {
            for &(tap, place) in self.of(i) {
                lists[place].push((tap, i));
            }
        }
        Self::of_lists(lists)
    }

    fn of_lists(lists: Vec<Vec<(usize, usize)>>) -> Self {
        let taps = |list: &Vec<(usize, usize)>| list.iter().map(|p| p.0).collect::<Vec<_>>();
        let same_taps = |i: usize| {
            let block = lists.get(i..i + BLOCK);
            block.is_some_and(|block| block.iter().all(|list| taps(list) == taps(&block[0])))
        };
        let ends = lists.iter().scan(0, |end, list| {
            *end += list.len();
            Some(*end)
        });
        Self {
            same_taps: (0..lists.len()).map(same_taps).collect(),
            ends: ends.collect(),
            pairs: lists.concat(),
        }
    }

    fn len(&self) -> usize {
        self.ends.len()
    }

    #[inline(always)]
    fn of(&self, i: usize) -> &[(usize, usize)] {
        let start = if i == 0 { 0 } else { self.ends[i - 1] };
        &self.pairs[start..self.ends[i]]
    }

    /// Calls `several` for blocks of positions with the same taps, and `one` for the other positions.
    #[inline(always)]
    fn in_blocks(&self, mut several: impl FnMut(usize), mut one: impl FnMut(usize)) {
        let mut at = 0;
        while at < self.len() {
            if self.same_taps[at] {
                several(at);
                at += BLOCK;
            } else {
                one(at);
                at += 1;
            }
        }
    }
}

/// Computes one line of the result.
struct Gather<'a> {
    filter: &'a Filter,
    /// One image, and its number of columns.
    x: &'a [f32],
    width: usize,
    taps: usize,
    rows: &'a [(usize, usize)],
    columns: &'a AxisTaps,
    tail: Tail<'a>,
    output: Shared<'a>,
}

impl Kernel for Gather<'_> {
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        let columns = self.columns;
        // SAFETY: as demanded from the caller.
        columns.in_blocks(
            #[inline(always)]
            |at| unsafe { self.places::<V, BLOCK>(at) },
            #[inline(always)]
            |at| unsafe { self.places::<V, 1>(at) },
        );
    }
}

impl Gather<'_> {
    /// Computes `N` positions of the line, which have the same taps.
    ///
    /// # Safety
    /// As for `Vector`; positions are inside the image, taps inside the filter, columns inside the line.
    #[inline(always)]
    unsafe fn places<V: Vector, const N: usize>(&self, at: usize) {
        let channels = self.filter.bias.len();
        let lists: [&[(usize, usize)]; N] = std::array::from_fn(|j| self.columns.of(at + j));
        for c in (0..channels).step_by(V::LANES) {
            let count = channels - c;
            // SAFETY: as demanded from the caller.
            unsafe {
                let mut sums = [V::load_some(self.filter.bias.as_ptr().add(c), count); N];
                for &(down, y) in self.rows {
                    for (k, &(along, _)) in lists[0].iter().enumerate() {
                        let tap = (down * self.taps + along) * channels + c;
                        let weight = V::load_some(self.filter.weights.as_ptr().add(tap), count);
                        for (sum, list) in sums.iter_mut().zip(lists) {
                            let place = (y * self.width + list[k].1) * channels + c;
                            let value = V::load_some(self.x.as_ptr().add(place), count);
                            *sum = value.mul_add(weight, *sum);
                        }
                    }
                }
                for (j, sum) in sums.into_iter().enumerate() {
                    let to = (at + j) * channels + c;
                    let sum = self.tail.finish(sum, to, count);
                    sum.store_some(self.output.at(to, count.min(V::LANES)), count);
                }
            }
        }
    }
}

/// Adds the products of inputs and gradients over some lines of all images.
struct Correlate<'a> {
    x: &'a [f32],
    grad: &'a [f32],
    shape: &'a Shape,
    taps: &'a [AxisTaps; 2],
    lines: std::ops::Range<usize>,
    sums: Shared<'a>,
}

impl Kernel for Correlate<'_> {
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        for line in self.lines.clone() {
            // SAFETY: as demanded from the caller.
            self.taps[1].in_blocks(
                #[inline(always)]
                |at| unsafe { self.places::<V, BLOCK>(line, at) },
                #[inline(always)]
                |at| unsafe { self.places::<V, 1>(line, at) },
            );
        }
    }
}

impl Correlate<'_> {
    /// Adds `N` positions of a line, which have the same taps.
    ///
    /// # Safety
    /// As for `Vector`; positions are inside the images, taps inside the sums.
    #[inline(always)]
    unsafe fn places<V: Vector, const N: usize>(&self, line: usize, at: usize) {
        let [rows, columns] = self.taps;
        let (channels, taps) = (self.shape.channels, self.shape.taps);
        let image = line / rows.len() * self.shape.height;
        let lists: [&[(usize, usize)]; N] = std::array::from_fn(|j| columns.of(at + j));
        for c in (0..channels).step_by(V::LANES) {
            let count = channels - c;
            // SAFETY: as demanded from the caller.
            unsafe {
                let from = (line * columns.len() + at) * channels + c;
                let mut grads = [V::splat(0.0); N];
                for (j, grad) in grads.iter_mut().enumerate() {
                    *grad = V::load_some(self.grad.as_ptr().add(from + j * channels), count);
                }
                for &(down, y) in rows.of(line % rows.len()) {
                    for (k, &(along, _)) in lists[0].iter().enumerate() {
                        let tap = (down * taps + along) * channels + c;
                        let to = self.sums.at(tap, count.min(V::LANES));
                        let mut sum = V::load_some(to, count);
                        for (grad, list) in grads.iter().zip(lists) {
                            let place = ((image + y) * self.shape.width + list[k].1) * channels;
                            let value = V::load_some(self.x.as_ptr().add(place + c), count);
                            sum = value.mul_add(*grad, sum);
                        }
                        sum.store_some(to, count);
                    }
                }
            }
        }
    }
}
