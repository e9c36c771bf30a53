//! Partial Cholesky factorisation of a dense block.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::matmul::triangular::{BlockStructure, matmul};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Accum, MatMut, MatRef, Par};
use lsdc_kernels::simd::Level;

/// Larger blocks are worth blocked algorithms.
const SMALL: usize = 160;

/// Cholesky of the first `count` columns; the rest becomes its Schur complement.
pub(super) fn factorise(values: &mut [f64], size: usize, count: usize, level: Level) -> Option<()> {
    if size <= SMALL {
        return level.vectorised(
            #[inline(always)]
            || eliminate_by_columns(values, size, count),
        );
    }
    let equations = MatMut::from_column_major_slice_mut(values, size, size);
    let (left, right) = equations.split_at_col_mut(count);
    let (mut top, mut bottom) = left.split_at_row_mut(count);
    let scratch = cholesky_in_place_scratch::<f64>(count, Par::Seq, faer::prelude::default());
    cholesky_in_place(
        top.as_mut(),
        faer::prelude::default(),
        Par::Seq,
        MemStack::new(&mut MemBuffer::new(scratch)),
        faer::prelude::default(),
    )
    .ok()?;
    let transposed = bottom.as_mut().transpose_mut();
    solve_lower_triangular_in_place(top.as_ref(), transposed, Par::Seq);
    let (_, rest) = right.split_at_row_mut(count);
    add_product(rest, bottom.as_ref(), -1.0);
    Some(())
}

/// The same, without what is 0: in small fronts most pixels are not joined yet. A few columns at
/// once, which spares memory traffic.
#[inline(always)]
fn eliminate_by_columns(values: &mut [f64], size: usize, count: usize) -> Option<()> {
    const TOGETHER: usize = 4;
    let mut first = 0;
    while first < count {
        let end = (first + TOGETHER).min(count);
        for j in first..end {
            let (known, later) = values.split_at_mut((j + 1) * size);
            let column = &mut known[j * size + j..];
            let pivot = column[0];
            if !(pivot > 0.0 && pivot.is_finite()) {
                return None;
            }
            let scale = pivot.sqrt().recip();
            for value in column.iter_mut() {
                *value *= scale;
            }
            for (k, target) in later.chunks_exact_mut(size).take(end - j - 1).enumerate() {
                let own = &column[k + 1..];
                let factor = own[0];
                let targets = target[j + k + 1..].iter_mut();
                targets.zip(own).for_each(|(t, v)| *t -= factor * v);
            }
        }
        let (known, later) = values.split_at_mut(end * size);
        let column = |j: usize| &known[j.min(end - 1) * size..][..size];
        let block: [&[f64]; TOGETHER] = std::array::from_fn(|i| column(first + i));
        for (k, target) in (end..).zip(later.chunks_exact_mut(size)) {
            let factors: [f64; TOGETHER] =
                std::array::from_fn(|i| if first + i < end { block[i][k] } else { 0.0 });
            if factors == [0.0; TOGETHER] {
                continue;
            }
            let [a, b, c, d] = block.map(|column| &column[k..]);
            let target = &mut target[k..];
            let length = target.len();
            let (a, b, c, d) = (&a[..length], &b[..length], &c[..length], &d[..length]);
            for (i, target) in target.iter_mut().enumerate() {
                let sum = factors[0] * a[i] + factors[1] * b[i];
                *target -= sum + (factors[2] * c[i] + factors[3] * d[i]);
            }
        }
        first = end;
    }
    Some(())
}

/// `block += scale rows rows^T`, lower half.
pub(super) fn add_product(block: MatMut<'_, f64>, rows: MatRef<'_, f64>, scale: f64) {
    let whole = BlockStructure::Rectangular;
    matmul(
        block,
        BlockStructure::TriangularLower,
        Accum::Add,
        rows,
        whole,
        rows.transpose(),
        whole,
        scale,
        Par::Seq,
    );
}
