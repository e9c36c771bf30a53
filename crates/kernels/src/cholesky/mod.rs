//! Partial Cholesky factorisation in f64, as multifrontal solvers of sparse equations need it: of a matrix
//!
//! > `[ A  B' ]`
//! > `[ B  C  ]`
//!
//! the columns of the factor `L = [L_A; L_B]` with `L_A L_A' = A` and `L_B = B L_A'^-1`, and the update matrix,
//! the Schur complement `C - L_B L_B'`. Matrices are stored column by column; of symmetric ones, the lower half counts.
//! The numbers of rows below A are multiples of [`PAD`]; what pads them is 0.

mod dense;
mod lanes;
#[cfg(test)]
mod tests;

pub use dense::{MatrixBlock, factorise, solve_rows, subtract_product};
pub use lanes::{F64x8, factorise_eight};

/// Rows below the square block come in multiples of this.
pub const PAD: usize = 8;

/// All rows of a panel of so many values and columns, and those below the square block.
///
/// # Panics
/// If there are no such rows, or those below are no multiple of `pad`.
fn panel_rows(length: usize, columns: usize, pad: usize) -> [usize; 2] {
    let rows = length / columns;
    assert!(is_size(length, rows, columns), "panel");
    let below = rows.checked_sub(columns).expect("rows of the panel");
    assert!(below.is_multiple_of(pad), "rows below the square block");
    [rows, below]
}

/// The columns of the block that begins at `first`. The first block has the columns that are left over, so that the rows
/// below the others come in multiples of `size`.
#[inline(always)]
fn block_columns(first: usize, columns: usize, size: usize) -> usize {
    match columns % size {
        left if first == 0 && left > 0 => left,
        _ => size,
    }
}

/// Whether a matrix of this size has so many values.
fn is_size(length: usize, rows: usize, columns: usize) -> bool {
    rows.checked_mul(columns) == Some(length)
}
