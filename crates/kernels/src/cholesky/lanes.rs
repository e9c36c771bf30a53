//! Factorisation of eight small matrices of one shape at a time, one in each lane.

use super::{block_columns, is_size, panel_rows};
use crate::simd::{Doubles, Kernel, Level, Vector};

/// The same element of eight matrices.
pub type F64x8 = [f64; 8];

/// The number of rows below the square block is a multiple of this.
const TILE: usize = 4;

/// [`super::factorise`] of eight matrices at once; here the number of rows below is a multiple of 4.
///
/// # Panics
/// If lengths do not match, or the number of rows below is not a multiple of 4.
pub fn factorise_eight(
    level: Level,
    panel: &mut [F64x8],
    columns: usize,
    update: &mut [F64x8],
) -> bool {
    if columns == 0 {
        return true;
    }
    let [rows, below] = panel_rows(panel.len(), columns, TILE);
    assert!(is_size(update.len(), below, below), "update");
    let kernel = FactoriseEight {
        panel,
        rows,
        columns,
        update,
        below,
    };
    // SAFETY: the assertions above check the lengths.
    unsafe { level.run(kernel) }
}

struct FactoriseEight<'a> {
    panel: &'a mut [F64x8],
    rows: usize,
    columns: usize,
    update: &'a mut [F64x8],
    below: usize,
}

impl Kernel for FactoriseEight<'_> {
    type Output = bool;

    #[inline(always)]
    unsafe fn run<V: Vector>(self) -> bool {
        let lanes = <V::Doubles as Doubles>::LANES;
        let mut positive = true;
        for first in (0..8).step_by(lanes) {
            // SAFETY: the caller checked all lengths; a vector of either size is within its eight values.
            positive &= unsafe {
                let panel = self.panel.as_mut_ptr().cast::<f64>().add(first);
                let update = self.update.as_mut_ptr().cast::<f64>().add(first);
                partial::<V::Doubles>(panel, self.rows, self.columns, update, self.below)
            };
        }
        positive
    }
}

/// Distance between elements of a matrix in memory.
const STEP: usize = 8;

/// Computes `target -= a b'` for `R` rows and 4 columns.
#[inline(always)]
unsafe fn tile<D: Doubles, const R: usize>(
    target: *mut f64,
    stride: usize,
    a: *const f64,
    b: *const f64,
    rows: usize,
    depth: usize,
) {
    // SAFETY: as demanded from the caller.
    unsafe {
        let mut sums = [[D::splat(0.0); R]; TILE];
        for (q, column) in sums.iter_mut().enumerate() {
            for (r, sum) in column.iter_mut().enumerate() {
                *sum = D::load(target.add((q * stride + r) * STEP));
            }
        }
        for p in 0..depth {
            let mut values = [D::splat(0.0); R];
            for (r, value) in values.iter_mut().enumerate() {
                *value = D::load(a.add((p * rows + r) * STEP));
            }
            for (q, column) in sums.iter_mut().enumerate() {
                let factor = D::load(b.add((p * rows + q) * STEP));
                for (sum, value) in column.iter_mut().zip(values) {
                    *sum = sum.less_product(value, factor);
                }
            }
        }
        for (q, column) in sums.into_iter().enumerate() {
            for (r, sum) in column.into_iter().enumerate() {
                sum.store(target.add((q * stride + r) * STEP));
            }
        }
    }
}

/// Computes four columns of `target -= a b'` from a row on, in tiles of as many rows as fit the registers.
#[inline(always)]
unsafe fn strip<D: Doubles>(
    target: *mut f64,
    stride: usize,
    [a, b]: [*const f64; 2],
    rows: usize,
    depth: usize,
    count: usize,
) {
    for row in (0..count).step_by(TILE) {
        // SAFETY: as demanded from the caller.
        unsafe {
            let (target, a) = (target.add(row * STEP), a.add(row * STEP));
            if D::LANES == 8 {
                tile::<D, 4>(target, stride, a, b, rows, depth);
            } else {
                tile::<D, 2>(target, stride, a, b, rows, depth);
                let (target, a) = (target.add(2 * STEP), a.add(2 * STEP));
                tile::<D, 2>(target, stride, a, b, rows, depth);
            }
        }
    }
}

/// Factorises the first `C` columns, from which all previous columns are already subtracted; false if a pivot is not positive.
#[inline(always)]
unsafe fn columns_of<D: Doubles, const C: usize>(own: *mut f64, rows: usize, count: usize) -> bool {
    // SAFETY: as demanded from the caller.
    unsafe {
        let at = |i: usize, q: usize| own.add((q * rows + i) * STEP);
        let mut triangle = [[D::splat(0.0); C]; C];
        let mut inverse = [D::splat(0.0); C];
        for q in 0..C {
            let mut pivot = D::load(at(q, q));
            for value in &triangle[q][..q] {
                pivot = pivot.less_product(*value, *value);
            }
            let mut pivots = [1.0; STEP];
            pivot.store(pivots.as_mut_ptr());
            if !pivots.iter().all(|pivot| *pivot > 0.0 && pivot.is_finite()) {
                return false;
            }
            let root = pivot.sqrt();
            inverse[q] = D::splat(1.0).div(root);
            root.store(at(q, q));
            for i in q + 1..C {
                let mut value = D::load(at(i, q));
                for (one, other) in triangle[i][..q].iter().zip(&triangle[q][..q]) {
                    value = value.less_product(*one, *other);
                }
                triangle[i][q] = value.mul(inverse[q]);
                triangle[i][q].store(at(i, q));
            }
        }
        for i in C..count {
            let mut solved = [D::splat(0.0); C];
            for q in 0..C {
                let mut value = D::load(at(i, q));
                for (solved, factor) in solved[..q].iter().zip(&triangle[q][..q]) {
                    value = value.less_product(*solved, *factor);
                }
                solved[q] = value.mul(inverse[q]);
                solved[q].store(at(i, q));
            }
        }
    }
    true
}

#[inline(always)]
unsafe fn partial<D: Doubles>(
    panel: *mut f64,
    rows: usize,
    columns: usize,
    update: *mut f64,
    below: usize,
) -> bool {
    // SAFETY: as demanded from the caller.
    unsafe {
        let mut first = 0;
        while first < columns {
            let count = block_columns(first, columns, TILE);
            let own = panel.add((first * rows + first) * STEP);
            if first > 0 {
                let before: *const f64 = panel.add(first * STEP);
                strip::<D>(own, rows, [before; 2], rows, first, rows - first);
            }
            let is_positive = match count {
                1 => columns_of::<D, 1>(own, rows, rows - first),
                2 => columns_of::<D, 2>(own, rows, rows - first),
                3 => columns_of::<D, 3>(own, rows, rows - first),
                _ => columns_of::<D, TILE>(own, rows, rows - first),
            };
            if !is_positive {
                return false;
            }
            first += count;
        }
        for column in (0..below).step_by(TILE) {
            let factor: *const f64 = panel.add((columns + column) * STEP);
            let target = update.add((column * below + column) * STEP);
            strip::<D>(target, below, [factor; 2], rows, columns, below - column);
        }
    }
    true
}
