//! Runs of rows of a child's boundary in the front of its separator, so that blocks of equations are added as slices.

use std::ops::Range;

/// Consecutive variables of a child that are also consecutive in the front of its separator.
#[derive(Clone, Debug)]
pub(super) struct IndexRun {
    /// Range of the variables in the child's boundary.
    pub(super) from: Range<usize>,
    /// The row of the first in the front of the separator.
    pub(super) to: usize,
}

/// Returns the runs of consecutive variables among rows, which may be missing. No run contains both some of the first `count`
/// rows, which the front eliminates, and later ones.
pub(super) fn runs(rows: impl Iterator<Item = Option<u32>>, count: usize) -> Vec<IndexRun> {
    let mut runs: Vec<IndexRun> = Vec::new();
    for (from, row) in rows.enumerate() {
        let Some(to) = row.map(|row| row as usize) else {
            continue;
        };
        match runs.last_mut() {
            Some(run) if run.from.end == from && run.to + run.from.len() == to && to != count => {
                run.from.end += 1;
            }
            _ => runs.push(IndexRun {
                from: from..from + 1,
                to,
            }),
        }
    }
    runs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_end_at_gaps_and_where_rows_are_kept() {
        let rows = [Some(2), Some(3), None, Some(4), Some(5), Some(6), Some(9)];
        let found: Vec<_> = runs(rows.into_iter(), 5)
            .into_iter()
            .map(|run| (run.from, run.to))
            .collect();
        assert_eq!(found, [(0..2, 2), (3..4, 4), (4..6, 5), (6..7, 9)]);
    }
}
