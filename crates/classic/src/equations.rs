//! Linear equations between the pixels of an image, solved directly (by faer's sparse factorisations).

use crate::error::{Error, Result};
use faer::linalg::solvers::SolveCore as _;
use faer::sparse::{SparseColMat, Triplet};
use faer::{Conj, Mat};

/// A square sparse system, assembled entry by entry; entries at the same position are added.
pub(super) struct Equations {
    entries: Vec<Triplet<usize, usize, f64>>,
    right_hand_side: Vec<f64>,
}

impl Equations {
    /// A system without entries, with a right-hand side of zeros.
    pub(super) fn new(unknowns: usize) -> Self {
        Self {
            entries: Vec::with_capacity(6 * unknowns),
            right_hand_side: vec![0.0; unknowns],
        }
    }

    /// Adds a value to the matrix.
    pub(super) fn add(&mut self, row: usize, column: usize, value: f64) {
        self.entries.push(Triplet::new(row, column, value));
    }

    /// Adds a value to the right-hand side.
    pub(super) fn add_right(&mut self, row: usize, value: f64) {
        self.right_hand_side[row] += value;
    }

    /// Solves a regular system.
    pub(super) fn solve(self) -> Result<Vec<f64>> {
        let n = self.right_hand_side.len();
        let matrix = SparseColMat::<usize, f64>::try_new_from_triplets(n, n, &self.entries);
        let matrix = matrix.map_err(|_| Error::Singular)?;
        let factor = matrix.sp_lu().map_err(|_| Error::Singular)?;
        let mut solution = Mat::from_fn(n, 1, |i, _| self.right_hand_side[i]);
        factor.solve_in_place_with_conj(Conj::No, solution.as_mut());
        Ok(solution.col_as_slice(0).to_vec())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_system_is_solved() {
        // [4 1; 1 3] x = [1, 2] has the solution [1/11, 7/11].
        let mut equations = Equations::new(2);
        for (row, column, value) in [(0, 0, 4.0), (1, 0, 1.0), (0, 1, 1.0), (1, 1, 3.0)] {
            equations.add(row, column, value);
        }
        equations.add_right(0, 1.0);
        equations.add_right(1, 2.0);
        let solution = equations.solve().unwrap();
        assert!((solution[0] - 1.0 / 11.0).abs() < 1e-12);
        assert!((solution[1] - 7.0 / 11.0).abs() < 1e-12);
    }
}
