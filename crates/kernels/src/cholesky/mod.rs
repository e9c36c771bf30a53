//! Partial Cholesky factorisation in f64, as needed by multifrontal sparse solvers. It computes, for a matrix
//!
//! > `[ A  B' ]`
//! > `[ B  C  ]`
//!
//! the columns of the factor `L = [L_A; L_B]` with `L_A L_A' = A` and `L_B = B L_A'^-1`, and the update matrix, the Schur
//! complement `C - L_B L_B'`. Matrices are stored column by column; only the lower halves of symmetric matrices are read. The
//! numbers of rows below A are multiples of [`PAD`]; padding is 0.

mod dense;
mod lanes;
#[cfg(test)]
mod tests;

pub use dense::{MatrixBlock, factorise, solve_rows, subtract_product};
pub use lanes::{F64x8, factorise_eight};

/// The number of rows below the square block is a multiple of this.
pub const PAD: usize = 8;

/// Returns the numbers of all rows of a panel with this many values and columns, and of those below the square block.
///
/// # Panics
/// If there are no such rows, or the number of rows below is not a multiple of `pad`.
fn panel_rows(length: usize, columns: usize, pad: usize) -> [usize; 2] {
    let rows = length / columns;
    assert!(is_size(length, rows, columns), "panel");
    let below = rows.checked_sub(columns).expect("rows of the panel");
    assert!(below.is_multiple_of(pad), "rows below the square block");
    [rows, below]
}

/// Returns the number of columns of the block that begins at `first`. The first block has the remainder, so that the number of
/// rows below the others is a multiple of `size`.
#[inline(always)]
fn block_columns(first: usize, columns: usize, size: usize) -> usize {
    match columns % size {
        left if first == 0 && left > 0 => left,
        _ => size,
    }
}

/// Whether a matrix of this size has this many values.
fn is_size(length: usize, rows: usize, columns: usize) -> bool {
    rows.checked_mul(columns) == Some(length)
}
