//! The matrix product used by every layer: rows of inputs times panels of weights.

use super::{Buffer, Kernel, Level, Shared, Unset, Vector, unset};
use crate::schedule::InTasks;
use rayon::prelude::*;
use std::ops::Range;

/// A matrix in memory: element (r, k) is at `pointer + r * row + k * step`.
#[derive(Clone, Copy)]
pub(crate) struct Rows {
    pub(crate) pointer: *const f32,
    pub(crate) row: usize,
    pub(crate) step: usize,
}

/// Returns the same pointer, and prevents later loads from being moved before this point.
#[inline(always)]
fn pinned(pointer: *const f32) -> *const f32 {
    #[cfg(all(target_arch = "x86_64", not(miri)))]
    {
        let mut pointer = pointer;
        // SAFETY: the assembly is empty.
        unsafe {
            std::arch::asm!("/* {0} */", inout(reg) pointer, options(nostack, preserves_flags));
        }
        pointer
    }
    #[cfg(not(all(target_arch = "x86_64", not(miri))))]
    pointer
}

/// Computes `N` rows times a panel of `W` vectors' width, summed over some steps.
///
/// # Safety
/// As for `Vector`; every step is inside the `N` rows of `a` and the panel's rows, which are `b_row` apart.
#[inline(always)]
unsafe fn tile<V: Vector, const N: usize, const W: usize>(
    a: Rows,
    steps: impl Iterator<Item = usize>,
    b: *const f32,
    b_row: usize,
) -> [[V; W]; N] {
    // SAFETY: as demanded from the caller.
    unsafe {
        let mut sums = [[V::splat(0.0); W]; N];
        for k in steps {
            let mut columns = [V::splat(0.0); W];
            for (i, column) in columns.iter_mut().enumerate() {
                *column = V::load(b.add(k * b_row + i * V::LANES));
            }
            let mut a_k = a.pointer.add(k * a.step);
            for (r, sum) in sums.iter_mut().enumerate() {
                // Without this, the compiler loads the factors of all rows in advance and spills sums from the registers
                // (measured: half the rate). Three rows share an address.
                if r > 0 && r % 3 == 0 {
                    a_k = pinned(a_k.wrapping_add(3 * a.row));
                }
                let value = V::broadcast(a_k.add(r % 3 * a.row));
                for (sum, column) in sum.iter_mut().zip(columns) {
                    *sum = value.mul_add(column, *sum);
                }
            }
        }
        sums
    }
}

/// Computes `count` rows times a panel of `W` vectors' width, 1 or 2; passes each result to `sink(row, sums)`.
///
/// A row's result does not depend on the other rows.
///
/// # Safety
/// As for `Vector`; `a` has `count` rows of `depth`, the panel has `depth` rows `b_row` apart.
#[inline(always)]
pub(crate) unsafe fn product<V: Vector, const W: usize>(
    a: Rows,
    count: usize,
    depth: usize,
    b: *const f32,
    b_row: usize,
    sink: impl FnMut(usize, [V; W]),
) {
    // SAFETY: as demanded from the caller.
    unsafe { product_in_steps(a, count, |_| 0..depth, b, b_row, sink) }
}

/// Like [`product`], in the given steps of each block of rows, in ascending order.
///
/// # Safety
/// As for `Vector`; every step is inside the `count` rows of `a` and the panel's rows, which are `b_row` apart.
#[inline(always)]
unsafe fn product_in_steps<V: Vector, const W: usize, S: Iterator<Item = usize>>(
    a: Rows,
    count: usize,
    steps: impl Fn(usize) -> S,
    b: *const f32,
    b_row: usize,
    mut sink: impl FnMut(usize, [V; W]),
) {
    for (block, rows) in blocks::<V>(count).enumerate() {
        let first = rows.start;
        macro_rules! tiles {
            ($($n:literal)*) => {
                match rows.len() {
                    $($n => {
                        // SAFETY: as demanded from the caller.
                        let sums = unsafe {
                            let pointer = a.pointer.add(first * a.row);
                            tile::<V, $n, W>(Rows { pointer, ..a }, steps(block), b, b_row)
                        };
                        for (r, sum) in sums.into_iter().enumerate() {
                            sink(first + r, sum);
                        }
                    })*
                    _ => unreachable!("no vector has more than 14 rows"),
                }
            };
        }
        tiles!(1 2 3 4 5 6 7 8 9 10 11 12 13 14);
    }
}

/// Returns the blocks of rows that are multiplied at once.
#[inline(always)]
fn blocks<V: Vector>(count: usize) -> impl Iterator<Item = Range<usize>> {
    let mut first = 0;
    (1..=count.div_ceil(V::ROWS)).rev().map(move |left| {
        let start = first;
        first += (count - first).div_ceil(left);
        start..first
    })
}

/// The steps of each block of rows with a non-zero factor in any row.
struct Active {
    steps: Vec<u32>,
    /// Start of the steps of each block, followed by the end.
    starts: Vec<usize>,
}

impl Active {
    /// Finds the steps, for rows with contiguous factors.
    ///
    /// # Safety
    /// `a` has `count` rows of `depth`.
    #[inline(always)]
    unsafe fn new<V: Vector>(a: Rows, count: usize, depth: usize) -> Self {
        let block_count = count.div_ceil(V::ROWS);
        let mut steps = vec![0; block_count * depth];
        let mut starts = Vec::with_capacity(block_count + 1);
        starts.push(0);
        let (mut combined, mut end) = (vec![0; depth], 0);
        for rows in blocks::<V>(count) {
            combined.fill(0);
            for row in rows {
                // SAFETY: as demanded from the caller.
                let row = unsafe { std::slice::from_raw_parts(a.pointer.add(row * a.row), depth) };
                // All bits except the sign, because -0 also counts as 0.
                let bits = row.iter().map(|value| value.to_bits() << 1);
                let pairs = combined.iter_mut().zip(bits);
                pairs.for_each(|(combined, bits)| *combined |= bits);
            }
            for (step, bits) in (0..).zip(&combined) {
                steps[end] = step;
                end += usize::from(*bits != 0);
            }
            starts.push(end);
        }
        Self { steps, starts }
    }

    #[inline(always)]
    fn of(&self, block: usize) -> impl Iterator<Item = usize> {
        let steps = &self.steps[self.starts[block]..self.starts[block + 1]];
        steps.iter().map(|&step| step as usize)
    }
}

/// The operations after a product and its bias.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tail<'a> {
    /// Added to the product, with the shape of the output.
    pub skip: Option<&'a [f32]>,
    /// Whether a ReLU follows.
    pub relu: bool,
}

impl Tail<'_> {
    /// Applies the operations to `count` floats of the output, starting at `at`.
    ///
    /// # Safety
    /// As for `Vector`; the skip, if any, contains these floats.
    #[inline(always)]
    pub(crate) unsafe fn finish<V: Vector>(&self, sum: V, at: usize, count: usize) -> V {
        // SAFETY: as demanded from the caller.
        unsafe {
            let sum = match self.skip {
                Some(skip) => sum.add(V::load_some(skip.as_ptr().add(at), count)),
                None => sum,
            };
            if self.relu {
                sum.max(V::splat(0.0))
            } else {
                sum
            }
        }
    }
}

/// A matrix `[depth, columns]` and a bias, divided into panels `[panel][depth][width]` and padded with zeros.
#[derive(Clone, Debug)]
pub struct Packed {
    level: Level,
    depth: usize,
    columns: usize,
    /// Width of a panel: two vectors.
    width: usize,
    values: Buffer,
    /// Bias, padded to whole panels.
    bias: Vec<f32>,
}

impl Packed {
    /// Packs `at(row, column)`; an empty bias is 0.
    ///
    /// # Panics
    /// If the number of biases does not match the columns, or the number of values overflows.
    pub fn new(
        level: Level,
        (depth, columns): (usize, usize),
        bias: &[f32],
        at: impl Fn(usize, usize) -> f32,
    ) -> Self {
        let width = 2 * level.lanes();
        assert!(bias.is_empty() || bias.len() == columns, "bias");
        let panels = columns.div_ceil(width);
        let length = depth
            .checked_mul(width)
            .and_then(|panel| panel.checked_mul(panels));
        let mut values = Buffer::zeros(length.expect("more weights than can be counted"));
        for (i, values) in values.chunks_exact_mut(width).enumerate() {
            let (first, row) = (i / depth * width, i % depth);
            for (value, column) in values.iter_mut().zip(first..columns) {
                *value = at(row, column);
            }
        }
        let mut bias = bias.to_vec();
        bias.resize(panels * width, 0.0);
        Self {
            level,
            depth,
            columns,
            width,
            values,
            bias,
        }
    }

    /// The number of columns.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Computes `output [rows, columns] = tail(x [rows, depth] * self + bias)` on this thread. The rows of `x` may be longer;
    /// values beyond `depth` are ignored.
    pub fn apply(&self, x: &[f32], tail: Tail<'_>, output: &mut [f32]) {
        // SAFETY: `write` writes floats.
        self.write(x, tail, unsafe { unset(output) });
    }

    /// Like [`Self::apply`], for an input with many zeros, such as the output of a ReLU: columns that are 0 in all rows of a
    /// block are skipped. The sums are bitwise equal.
    pub fn apply_sparse(&self, x: &[f32], tail: Tail<'_>, output: &mut [f32]) {
        // SAFETY: `write_some` writes floats.
        self.write_some(x, tail, unsafe { unset(output) }, true);
    }

    /// Like `apply`; sets every float of the output.
    pub(crate) fn write(&self, x: &[f32], tail: Tail<'_>, output: &mut Unset) {
        self.write_some(x, tail, output, false);
    }

    fn write_some(&self, x: &[f32], tail: Tail<'_>, output: &mut Unset, sparse: bool) {
        let rows = output.len() / self.columns.max(1);
        assert!(
            rows == 0 || x.len() / rows >= self.depth && x.len().is_multiple_of(rows),
            "input"
        );
        assert_eq!(output.len(), rows * self.columns, "output");
        assert!(tail.skip.is_none_or(|skip| skip.len() == output.len()));
        let kernel = Apply {
            packed: self,
            x,
            tail,
            output: Shared::unset(output),
            rows,
            sparse,
        };
        // SAFETY: the assertions hold what the kernel relies on.
        unsafe { self.level.run(kernel) }
    }

    /// Like [`Self::apply`], with all threads.
    pub fn apply_parallel(&self, x: &[f32], tail: Tail<'_>, output: &mut [f32]) {
        // SAFETY: `write_parallel` writes floats.
        self.write_parallel(x, tail, unsafe { unset(output) });
    }

    /// Like `write`, with all threads.
    pub(crate) fn write_parallel(&self, x: &[f32], tail: Tail<'_>, output: &mut Unset) {
        /// Rows per task: a multiple of the register tile of every level.
        const ROWS: usize = 84;
        let piece = ROWS * self.columns.max(1);
        let outputs = output.par_chunks_mut(piece).enumerate();
        outputs.each(|(i, output)| {
            let rows = output.len() / self.columns.max(1);
            let x = &x[i * ROWS * self.depth..][..rows * self.depth];
            let skip = tail.skip.map(|skip| &skip[i * piece..][..output.len()]);
            self.write(x, Tail { skip, ..tail }, output);
        });
    }
}

struct Apply<'a> {
    packed: &'a Packed,
    x: &'a [f32],
    tail: Tail<'a>,
    output: Shared<'a>,
    rows: usize,
    /// Whether steps with only zero factors are skipped.
    sparse: bool,
}

impl Apply<'_> {
    /// Writes the sums of a row, starting at a column.
    ///
    /// # Safety
    /// As for `Vector`; the sums are inside the output.
    #[inline(always)]
    unsafe fn finish<V: Vector>(&self, row: usize, first: usize, sums: [V; 2], bias: [V; 2]) {
        let columns = self.packed.columns;
        for (half, (sum, bias)) in sums.into_iter().zip(bias).enumerate() {
            let column = first + half * V::LANES;
            if column < columns {
                let (at, count) = (row * columns + column, columns - column);
                // SAFETY: as demanded from the caller.
                unsafe {
                    let value = self.tail.finish(sum.add(bias), at, count);
                    let to = self.output.at(at, count.min(V::LANES));
                    value.store_some(to, count);
                }
            }
        }
    }
}

impl Kernel for Apply<'_> {
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        if self.rows == 0 {
            return;
        }
        let Packed {
            depth,
            columns,
            width,
            ..
        } = *self.packed;
        let rows = Rows {
            pointer: self.x.as_ptr(),
            row: self.x.len() / self.rows,
            step: 1,
        };
        // SAFETY: the caller checked all lengths.
        let active = (self.sparse).then(|| unsafe { Active::new::<V>(rows, self.rows, depth) });
        for first in (0..columns).step_by(width) {
            // SAFETY: the caller checked all lengths; bias and panels are padded.
            unsafe {
                let bias = self.packed.bias.as_ptr().add(first);
                let bias = [V::load(bias), V::load(bias.add(V::LANES))];
                let panel = self.packed.values.as_ptr().add(first * depth);
                match &active {
                    None => product::<V, 2>(
                        rows,
                        self.rows,
                        depth,
                        panel,
                        width,
                        #[inline(always)]
                        |row, sums| self.finish(row, first, sums, bias),
                    ),
                    Some(active) => product_in_steps(
                        rows,
                        self.rows,
                        #[inline(always)]
                        |block| active.of(block),
                        panel,
                        width,
                        #[inline(always)]
                        |row, sums| self.finish(row, first, sums, bias),
                    ),
                }
            }
        }
    }
}
