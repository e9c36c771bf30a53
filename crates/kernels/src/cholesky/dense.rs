//! Factorisation of one matrix at a time.

use super::{PAD, block_columns, is_size, panel_rows};
use crate::simd::{Doubles, Kernel, Level, Vector};

/// A matrix stored column by column, its columns `stride` values apart.
#[derive(Clone, Copy, Debug)]
pub struct MatrixBlock<'a> {
    /// The values, starting with the first one of the block.
    pub values: &'a [f64],
    /// Distance between columns.
    pub stride: usize,
}

impl MatrixBlock<'_> {
    /// The block without its first rows.
    ///
    /// # Panics
    /// If the block has fewer rows.
    #[must_use]
    pub fn below(self, rows: usize) -> Self {
        let values = &self.values[rows..];
        Self { values, ..self }
    }

    fn fits(&self, rows: usize, columns: usize) -> bool {
        fits(self.values.len(), self.stride, rows, columns)
    }
}

/// Whether a block with this many rows and columns fits in `length` values.
fn fits(length: usize, stride: usize, rows: usize, columns: usize) -> bool {
    let last = columns.saturating_sub(1).checked_mul(stride);
    rows == 0 || columns == 0 || {
        let end = last.and_then(|last| last.checked_add(rows));
        rows <= stride && end.is_some_and(|end| end <= length)
    }
}

/// Replaces the first `columns` columns of a matrix, the panel `[columns + below, columns]`, by those of its Cholesky
/// factor, and subtracts `L_B L_B'` from `update`, `[below, below]`, unless that is empty. False if a pivot is not
/// positive and finite; the values of both are then undefined.
///
/// # Panics
/// If lengths do not match, or the number of rows below is not a multiple of [`PAD`].
pub fn factorise(level: Level, panel: &mut [f64], columns: usize, update: &mut [f64]) -> bool {
    if columns == 0 {
        return true;
    }
    let [rows, below] = panel_rows(panel.len(), columns, PAD);
    assert!(
        update.is_empty() || is_size(update.len(), below, below),
        "update"
    );
    let kernel = Factorise {
        panel,
        rows,
        columns,
        update,
        below,
    };
    // SAFETY: the assertions above check the lengths.
    unsafe { level.run(kernel) }
}

/// Solves for further rows of a matrix with a known factor: replaces `extra`, `[count, columns]`, by `extra L_A'^-1`, and
/// subtracts its product with `L_B` from `update`, `[count, below]`. The panel is that of [`factorise`].
///
/// # Panics
/// If lengths do not match, or the number of rows below or `count` is not a multiple of [`PAD`].
pub fn solve_rows(
    level: Level,
    panel: &[f64],
    columns: usize,
    extra: &mut [f64],
    update: &mut [f64],
) {
    if columns == 0 {
        return;
    }
    let [rows, below] = panel_rows(panel.len(), columns, PAD);
    let count = extra.len() / columns;
    assert!(is_size(extra.len(), count, columns), "extra");
    assert!(count.is_multiple_of(PAD), "further rows");
    assert!(is_size(update.len(), count, below), "update");
    let kernel = SolveRows {
        panel,
        rows,
        columns,
        extra,
        count,
        update,
    };
    // SAFETY: the assertions above check the lengths.
    unsafe { level.run(kernel) }
}

/// Computes `target -= left right'`, with `left` `[rows, depth]` and `right` `[columns, depth]`; the columns of the target are
/// `stride` values apart.
///
/// # Panics
/// If a block is longer than its values, or rows or columns are not a multiple of [`PAD`].
pub fn subtract_product(
    level: Level,
    (target, stride): (&mut [f64], usize),
    [rows, columns, depth]: [usize; 3],
    left: MatrixBlock<'_>,
    right: MatrixBlock<'_>,
) {
    assert!(rows.is_multiple_of(PAD) && columns.is_multiple_of(PAD));
    assert!(fits(target.len(), stride, rows, columns), "target");
    assert!(left.fits(rows, depth), "left");
    assert!(right.fits(columns, depth), "right");
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
    // SAFETY: the assertions above check the lengths.
    unsafe { level.run(kernel) }
}

/// A matrix in memory: element (i, k) is at `at + i + k * stride`.
#[derive(Clone, Copy)]
struct Columns {
    at: *const f64,
    stride: usize,
}

impl Columns {
    /// Returns the submatrix that begins at a row and column.
    #[inline(always)]
    unsafe fn part(self, row: usize, column: usize) -> Self {
        // SAFETY: as demanded from the caller.
        let at = unsafe { self.at.add(column * self.stride + row) };
        Self { at, ..self }
    }
}

/// Computes `target -= a b'` for `R` vectors of rows and `C` columns.
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

/// Computes `target [rows, 8] -= a [rows, depth] b [8, depth]'`.
///
/// # Safety
/// The pointers are valid for the matrices; `rows` is a multiple of 8.
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
            bands::<D, 4>(target, stride, a, b.part(4, 0), depth, rows);
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
        while D::ROWS >= 3 && rows - row >= 3 * D::LANES {
            tile::<D, 3, C>(target.add(row), stride, a.part(row, 0), b, depth);
            row += 3 * D::LANES;
        }
        while rows - row >= 2 * D::LANES {
            tile::<D, 2, C>(target.add(row), stride, a.part(row, 0), b, depth);
            row += 2 * D::LANES;
        }
        while rows - row >= D::LANES {
            tile::<D, 1, C>(target.add(row), stride, a.part(row, 0), b, depth);
            row += D::LANES;
        }
    }
}

/// Computes `rows [count, columns] *= L'^-1` for at most 8 `columns`; `triangle` is L, `inverse` the reciprocals of its
/// diagonal.
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
            let mut solved = [D::splat(0.0); PAD];
            for (q, scale) in inverse.iter().enumerate() {
                let at = rows.add(q * stride + row);
                let mut value = D::load(at);
                for (d, solved) in solved.iter().enumerate().take(q) {
                    let factor = *triangle.at.add(d * triangle.stride + q);
                    value = value.less_product(*solved, D::splat(factor));
                }
                solved[q] = value.mul(D::splat(*scale));
                solved[q].store(at);
            }
        }
    }
}

struct Factorise<'a> {
    panel: &'a mut [f64],
    rows: usize,
    columns: usize,
    update: &'a mut [f64],
    below: usize,
}

impl Kernel for Factorise<'_> {
    type Output = bool;

    #[inline(always)]
    unsafe fn run<V: Vector>(self) -> bool {
        let Self {
            rows,
            columns,
            below,
            ..
        } = self;
        let panel = self.panel.as_mut_ptr();
        let factor = Columns {
            at: panel,
            stride: rows,
        };
        // SAFETY: the caller checked all lengths.
        unsafe {
            let mut first = 0;
            while first < columns {
                let count = block_columns(first, columns, PAD);
                let own = panel.add(first * rows + first);
                if first > 0 {
                    let before = factor.part(first, 0);
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
                let triangle = factor.part(first, first);
                let remaining = rows - first - count;
                let inverse = &inverse[..count];
                solve_few::<V::Doubles>(own.add(count), rows, remaining, triangle, inverse);
                first += count;
            }
            let below = if self.update.is_empty() { 0 } else { below };
            let update = self.update.as_mut_ptr();
            for column in (0..below).step_by(PAD) {
                let factor = factor.part(columns + column, 0);
                let target = update.add(column * below + column);
                strip::<V::Doubles>(target, below, factor, factor, columns, below - column);
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
    update: &'a mut [f64],
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
        let extra = self.extra.as_mut_ptr();
        let factor = Columns {
            at: self.panel.as_ptr(),
            stride: rows,
        };
        let solved = Columns {
            at: extra,
            stride: count,
        };
        // SAFETY: the caller checked all lengths.
        unsafe {
            let mut first = 0;
            while first < columns {
                let few = block_columns(first, columns, PAD);
                let target = extra.add(first * count);
                if first > 0 {
                    let before = factor.part(first, 0);
                    strip::<V::Doubles>(target, count, solved, before, first, count);
                }
                let triangle = factor.part(first, first);
                let mut inverse = [0.0; PAD];
                for (q, inverse) in inverse.iter_mut().enumerate().take(few) {
                    *inverse = (*triangle.at.add(q * rows + q)).recip();
                }
                solve_few::<V::Doubles>(target, count, count, triangle, &inverse[..few]);
                first += few;
            }
            let update = self.update.as_mut_ptr();
            for column in (0..rows - columns).step_by(PAD) {
                let below = factor.part(columns + column, 0);
                let target = update.add(column * count);
                strip::<V::Doubles>(target, count, solved, below, columns, count);
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
    left: MatrixBlock<'a>,
    right: MatrixBlock<'a>,
}

impl Kernel for SubtractProduct<'_> {
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        let matrix = |block: MatrixBlock<'_>| Columns {
            at: block.values.as_ptr(),
            stride: block.stride,
        };
        let (left, right) = (matrix(self.left), matrix(self.right));
        for column in (0..self.columns).step_by(PAD) {
            // SAFETY: the caller checked all lengths.
            unsafe {
                let target = self.target.as_mut_ptr().add(column * self.stride);
                let right = right.part(column, 0);
                strip::<V::Doubles>(target, self.stride, left, right, self.depth, self.rows);
            }
        }
    }
}
