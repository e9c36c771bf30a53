//! One matrix at a time.

use super::{PAD, is_size, panel_rows};
use crate::simd::{Doubles, Kernel, Level, Vector};

/// A matrix stored column by column, its columns `stride` values apart.
#[derive(Clone, Copy, Debug)]
pub struct Block<'a> {
    /// The values, from the first one of the block on.
    pub values: &'a [f64],
    /// From a column to the next.
    pub stride: usize,
}

impl Block<'_> {
    /// The rows from one on.
    ///
    /// # Panics
    /// If there are fewer.
    #[must_use]
    pub fn below(self, rows: usize) -> Self {
        let values = &self.values[rows..];
        Self { values, ..self }
    }

    fn holds(&self, rows: usize, columns: usize) -> bool {
        holds(self.values.len(), self.stride, rows, columns)
    }
}

/// Whether a block of so many rows and columns lies within `length` values.
fn holds(length: usize, stride: usize, rows: usize, columns: usize) -> bool {
    let last = columns.saturating_sub(1).checked_mul(stride);
    rows == 0 || columns == 0 || {
        let end = last.and_then(|last| last.checked_add(rows));
        rows <= stride && end.is_some_and(|end| end <= length)
    }
}

/// Replaces the first `columns` columns of a matrix by those of its Cholesky factor, and subtracts from `rest`,
/// `[kept, kept]`, what that leaves of it. The panel is `[columns + kept, columns]`. False if a pivot is not
/// positive and finite; panel and rest are then of no use. An empty `rest` is not asked for.
///
/// # Panics
/// If lengths do not match, or `kept` is no multiple of [`PAD`].
pub fn factorise(level: Level, panel: &mut [f64], columns: usize, rest: &mut [f64]) -> bool {
    if columns == 0 {
        return true;
    }
    let [rows, kept] = panel_rows(panel.len(), columns, PAD);
    assert!(rest.is_empty() || is_size(rest.len(), kept, kept), "rest");
    let kernel = Factorise {
        panel,
        rows,
        columns,
        rest,
        kept,
    };
    // SAFETY: the assertions hold what the kernel relies on.
    unsafe { level.run(kernel) }
}

/// Further rows of a matrix whose factor is known: replaces `extra`, `[count, columns]`, by `extra L_A'^-1`, and
/// subtracts its product with `L_B` from `rest`, `[count, kept]`. The panel is that of [`factorise`].
///
/// # Panics
/// If lengths do not match, or `kept` or `count` is no multiple of [`PAD`].
pub fn solve_rows(
    level: Level,
    panel: &[f64],
    columns: usize,
    extra: &mut [f64],
    rest: &mut [f64],
) {
    if columns == 0 {
        return;
    }
    let [rows, kept] = panel_rows(panel.len(), columns, PAD);
    let count = extra.len() / columns;
    assert!(is_size(extra.len(), count, columns), "extra");
    assert!(count.is_multiple_of(PAD), "further rows");
    assert!(is_size(rest.len(), count, kept), "rest");
    let kernel = SolveRows {
        panel,
        rows,
        columns,
        extra,
        count,
        rest,
    };
    // SAFETY: the assertions hold what the kernel relies on.
    unsafe { level.run(kernel) }
}

/// `target -= left right'`, with `left` `[rows, depth]` and `right` `[columns, depth]`; the columns of the target
/// are `stride` values apart.
///
/// # Panics
/// If a block is longer than its values, or rows or columns are no multiple of [`PAD`].
pub fn subtract_product(
    level: Level,
    (target, stride): (&mut [f64], usize),
    [rows, columns, depth]: [usize; 3],
    left: Block<'_>,
    right: Block<'_>,
) {
    assert!(rows.is_multiple_of(PAD) && columns.is_multiple_of(PAD));
    assert!(holds(target.len(), stride, rows, columns), "target");
    assert!(left.holds(rows, depth), "left");
    assert!(right.holds(columns, depth), "right");
    if rows == 0 || columns == 0 {
        return;
    }
    let kernel = SubtractProduct {
        target,
        stride,
        rows,
        columns,
        depth,
        left,
        right,
    };
    // SAFETY: the assertions hold what the kernel relies on.
    unsafe { level.run(kernel) }
}

/// A matrix in memory: element (i, k) is at `at + i + k * stride`.
#[derive(Clone, Copy)]
struct Columns {
    at: *const f64,
    stride: usize,
}

impl Columns {
    unsafe fn below(self, rows: usize) -> Self {
        // SAFETY: as demanded from the caller.
        let at = unsafe { self.at.add(rows) };
        Self { at, ..self }
    }
}

/// `R` vectors of rows times `C` columns: `target -= a b'`.
#[inline(always)]
unsafe fn tile<D: Doubles, const R: usize, const C: usize>(
    target: *mut f64,
    stride: usize,
    a: Columns,
    b: Columns,
    depth: usize,
) {
    // SAFETY: as demanded from the caller.
    unsafe {
        let mut sums = [[D::splat(0.0); R]; C];
        for (q, column) in sums.iter_mut().enumerate() {
            for (r, sum) in column.iter_mut().enumerate() {
                *sum = D::load(target.add(q * stride + r * D::LANES));
            }
        }
        for p in 0..depth {
            let mut rows = [D::splat(0.0); R];
            for (r, row) in rows.iter_mut().enumerate() {
                *row = D::load(a.at.add(p * a.stride + r * D::LANES));
            }
            for (q, column) in sums.iter_mut().enumerate() {
                let factor = D::splat(*b.at.add(p * b.stride + q));
                for (sum, row) in column.iter_mut().zip(rows) {
                    *sum = sum.less_product(row, factor);
                }
            }
        }
        for (q, column) in sums.into_iter().enumerate() {
            for (r, sum) in column.into_iter().enumerate() {
                sum.store(target.add(q * stride + r * D::LANES));
            }
        }
    }
}

/// `target [rows, 8] -= a [rows, depth] b [8, depth]'`.
///
/// # Safety
/// The matrices are there; `rows` is a multiple of 8.
#[inline(always)]
unsafe fn strip<D: Doubles>(
    target: *mut f64,
    stride: usize,
    a: Columns,
    b: Columns,
    depth: usize,
    rows: usize,
) {
    // SAFETY: as demanded from the caller.
    unsafe {
        if D::LANES == 8 {
            bands::<D, 8>(target, stride, a, b, depth, rows);
        } else {
            bands::<D, 4>(target, stride, a, b, depth, rows);
            let target = target.add(4 * stride);
            bands::<D, 4>(target, stride, a, b.below(4), depth, rows);
        }
    }
}

#[inline(always)]
unsafe fn bands<D: Doubles, const C: usize>(
    target: *mut f64,
    stride: usize,
    a: Columns,
    b: Columns,
    depth: usize,
    rows: usize,
) {
    let mut row = 0;
    // SAFETY: as demanded from the caller.
    unsafe {
        while rows - row >= 3 * D::LANES {
            tile::<D, 3, C>(target.add(row), stride, a.below(row), b, depth);
            row += 3 * D::LANES;
        }
        while rows - row >= 2 * D::LANES {
            tile::<D, 2, C>(target.add(row), stride, a.below(row), b, depth);
            row += 2 * D::LANES;
        }
        while rows - row >= D::LANES {
            tile::<D, 1, C>(target.add(row), stride, a.below(row), b, depth);
            row += D::LANES;
        }
    }
}

/// `rows [count, columns] *= L'^-1` for `columns` of at most 8; `triangle` is L, `inverse` that of its diagonal.
#[inline(always)]
unsafe fn solve_few<D: Doubles>(
    rows: *mut f64,
    stride: usize,
    count: usize,
    triangle: Columns,
    inverse: &[f64],
) {
    for row in (0..count).step_by(D::LANES) {
        // SAFETY: as demanded from the caller.
        unsafe {
            let mut known = [D::splat(0.0); PAD];
            for (q, scale) in inverse.iter().enumerate() {
                let at = rows.add(q * stride + row);
                let mut value = D::load(at);
                for (d, known) in known.iter().enumerate().take(q) {
                    let factor = *triangle.at.add(d * triangle.stride + q);
                    value = value.less_product(*known, D::splat(factor));
                }
                known[q] = value.mul(D::splat(*scale));
                known[q].store(at);
            }
        }
    }
}

struct Factorise<'a> {
    panel: &'a mut [f64],
    rows: usize,
    columns: usize,
    rest: &'a mut [f64],
    kept: usize,
}

impl Kernel for Factorise<'_> {
    type Output = bool;

    #[inline(always)]
    unsafe fn run<V: Vector>(self) -> bool {
        let Self {
            rows,
            columns,
            kept,
            ..
        } = self;
        let panel = self.panel.as_mut_ptr();
        // SAFETY: the caller checked all lengths. The first columns are those that are left over, so that rows
        // below the others come in whole vectors.
        unsafe {
            let mut first = 0;
            while first < columns {
                let count = match columns % PAD {
                    left if first == 0 && left > 0 => left,
                    _ => PAD,
                };
                let own = panel.add(first * rows + first);
                let before = Columns {
                    at: panel.add(first),
                    stride: rows,
                };
                if first > 0 {
                    strip::<V::Doubles>(own, rows, before, before, first, rows - first);
                }
                let mut inverse = [0.0; PAD];
                for (q, scale) in inverse.iter_mut().enumerate().take(count) {
                    let column = own.add(q * rows);
                    let pivot = *column.add(q);
                    if !(pivot > 0.0 && pivot.is_finite()) {
                        return false;
                    }
                    *scale = pivot.sqrt().recip();
                    for i in q..count {
                        *column.add(i) *= *scale;
                    }
                    for k in q + 1..count {
                        let factor = *column.add(k);
                        for i in k..count {
                            *own.add(k * rows + i) -= factor * *column.add(i);
                        }
                    }
                }
                let triangle = Columns {
                    at: own,
                    stride: rows,
                };
                let below = rows - first - count;
                let inverse = &inverse[..count];
                solve_few::<V::Doubles>(own.add(count), rows, below, triangle, inverse);
                first += count;
            }
            let kept = if self.rest.is_empty() { 0 } else { kept };
            let rest = self.rest.as_mut_ptr();
            for column in (0..kept).step_by(PAD) {
                let below = Columns {
                    at: panel.add(columns + column),
                    stride: rows,
                };
                let target = rest.add(column * kept + column);
                strip::<V::Doubles>(target, kept, below, below, columns, kept - column);
            }
        }
        true
    }
}

struct SolveRows<'a> {
    panel: &'a [f64],
    rows: usize,
    columns: usize,
    extra: &'a mut [f64],
    count: usize,
    rest: &'a mut [f64],
}

impl Kernel for SolveRows<'_> {
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        let Self {
            rows,
            columns,
            count,
            ..
        } = self;
        let (panel, extra) = (self.panel.as_ptr(), self.extra.as_mut_ptr());
        // SAFETY: the caller checked all lengths.
        unsafe {
            let known = Columns {
                at: extra,
                stride: count,
            };
            let mut first = 0;
            while first < columns {
                let few = match columns % PAD {
                    left if first == 0 && left > 0 => left,
                    _ => PAD,
                };
                let target = extra.add(first * count);
                let factor = Columns {
                    at: panel.add(first),
                    stride: rows,
                };
                if first > 0 {
                    strip::<V::Doubles>(target, count, known, factor, first, count);
                }
                let triangle = Columns {
                    at: panel.add(first * rows + first),
                    stride: rows,
                };
                let mut inverse = [0.0; PAD];
                for (q, inverse) in inverse.iter_mut().enumerate().take(few) {
                    *inverse = (*triangle.at.add(q * rows + q)).recip();
                }
                solve_few::<V::Doubles>(target, count, count, triangle, &inverse[..few]);
                first += few;
            }
            let rest = self.rest.as_mut_ptr();
            for column in (0..rows - columns).step_by(PAD) {
                let factor = Columns {
                    at: panel.add(columns + column),
                    stride: rows,
                };
                let target = rest.add(column * count);
                strip::<V::Doubles>(target, count, known, factor, columns, count);
            }
        }
    }
}

struct SubtractProduct<'a> {
    target: &'a mut [f64],
    stride: usize,
    rows: usize,
    columns: usize,
    depth: usize,
    left: Block<'a>,
    right: Block<'a>,
}

impl Kernel for SubtractProduct<'_> {
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        let matrix = |block: Block<'_>| Columns {
            at: block.values.as_ptr(),
            stride: block.stride,
        };
        let (left, right) = (matrix(self.left), matrix(self.right));
        for column in (0..self.columns).step_by(PAD) {
            // SAFETY: the caller checked all lengths.
            unsafe {
                let target = self.target.as_mut_ptr().add(column * self.stride);
                let right = right.below(column);
                strip::<V::Doubles>(target, self.stride, left, right, self.depth, self.rows);
            }
        }
    }
}
