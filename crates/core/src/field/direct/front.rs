//! The result of one elimination step: some columns of the Cholesky factor.

use super::columns::Columns;

/// Variables are pixels, then columns.
#[derive(Clone, Debug)]
pub(super) struct Front {
    pub(super) eliminated: Vec<u32>,
    /// Later variables that these depend on: pixels, then columns.
    pub(super) kept: Vec<u32>,
    /// The columns of the Cholesky factor: rows `eliminated`, then `kept`.
    pub(super) factor: Columns,
    /// Whether the columns are among `kept`.
    pub(super) joined: bool,
    /// Where each of `kept`, but for columns, is in the front of the whole that this is a half of:
    /// among its eliminated, then its kept.
    pub(super) inherited: Vec<u32>,
    /// How many fronts directly before this one are of its halves.
    pub(super) descendants: usize,
    /// How many of `kept` are columns.
    pub(super) columns: usize,
}

impl Front {
    /// The fronts of the halves, of which this one is at `at`.
    pub(super) fn halves(&self, at: usize, fronts: &[Self]) -> Vec<usize> {
        if self.descendants == 0 {
            return Vec::new();
        }
        let two = at - 1;
        vec![two - fronts[two].descendants - 1, two]
    }

    pub(super) fn kept_pixels(&self) -> &[u32] {
        &self.kept[..self.kept.len() - self.columns]
    }

    pub(super) fn forward(&self, values: &mut [f64]) {
        for (j, &variable) in self.eliminated.iter().enumerate() {
            let column = self.factor.column(j);
            let value = values[variable as usize] / column[0];
            values[variable as usize] = value;
            let later = self.eliminated[j + 1..].iter().chain(&self.kept);
            for (&other, factor) in later.zip(&column[1..]) {
                values[other as usize] -= factor * value;
            }
        }
    }

    /// Completes `values`: of the kept variables after room for the eliminated, whose right-hand
    /// sides are in `right`.
    pub(super) fn backward(&self, right: &[f64], values: &mut [f64]) {
        for (j, &variable) in self.eliminated.iter().enumerate().rev() {
            let column = self.factor.column(j);
            let known = dot(&column[1..], &values[j + 1..]);
            values[j] = (right[variable as usize] - known) / column[0];
        }
    }
}

/// Summed in eight lanes, which vector units can do.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut lanes = [0.0; 8];
    for (a, b) in a.chunks(8).zip(b.chunks(8)) {
        for ((lane, a), b) in lanes.iter_mut().zip(a).zip(b) {
            *lane += a * b;
        }
    }
    lanes.iter().sum()
}
