//! Where the variables that a half keeps are in the front of its line, by runs: so that blocks of equations are
//! added as slices.

use lsdc_kernels::cholesky::Eight;
use std::ops::Range;

/// Consecutive variables of a half that are consecutive in the front of its line, too.
#[derive(Clone, Debug)]
pub(super) struct Run {
    /// Among those that the half keeps.
    pub(super) from: Range<usize>,
    /// The row of the first in the front of the line.
    pub(super) to: usize,
}

/// The runs of rows, if any, of consecutive variables. None holds both some of the first `count` rows, which the
/// front eliminates, and later ones.
pub(super) fn runs(rows: impl Iterator<Item = Option<u32>>, count: usize) -> Vec<Run> {
    let mut runs: Vec<Run> = Vec::new();
    for (from, row) in rows.enumerate() {
        let Some(to) = row.map(|row| row as usize) else {
            continue;
        };
        match runs.last_mut() {
            Some(run) if run.from.end == from && run.to + run.from.len() == to && to != count => {
                run.from.end += 1;
            }
            _ => runs.push(Run {
                from: from..from + 1,
                to,
            }),
        }
    }
    runs
}

/// A value of a front: of one matrix, or of eight.
pub(super) trait Value: Copy {
    const ZERO: Self;

    fn add(&mut self, other: Self);
}

impl Value for f64 {
    const ZERO: Self = 0.0;

    #[inline(always)]
    fn add(&mut self, other: Self) {
        *self += other;
    }
}

impl Value for Eight {
    const ZERO: Self = [0.0; 8];

    #[inline(always)]
    fn add(&mut self, other: Self) {
        self.iter_mut()
            .zip(other)
            .for_each(|(sum, value)| *sum += value);
    }
}

/// What a half leaves: a matrix, lower half, whose variables are in ascending runs of a front's.
#[derive(Clone, Copy)]
pub(super) struct Left<'a, T> {
    pub(super) runs: &'a [Run],
    pub(super) values: &'a [T],
    pub(super) stride: usize,
}

/// Sets the lower half of a front, its first `count` columns in `panel`, `[rows, count]`, the others in `rest`, to
/// the sum of what halves leave: column by column, each of which is in the cache until it is done.
#[inline(always)]
pub(super) fn assemble<T: Value>(
    (panel, rest): (&mut [T], &mut [T]),
    [rows, count]: [usize; 2],
    halves: &[Left<'_, T>],
) {
    let kept = rows - count;
    let mut next = [0; 2];
    for to in 0..rows {
        let column = match to.checked_sub(count) {
            None => &mut panel[to * rows..][to..rows],
            Some(own) => &mut rest[own * kept..][own..kept],
        };
        column.fill(T::ZERO);
        for (half, next) in halves.iter().zip(&mut next) {
            let is_done = |run: &Run| run.to + run.from.len() <= to;
            while half.runs.get(*next).is_some_and(is_done) {
                *next += 1;
            }
            let Some(run) = half.runs.get(*next).filter(|run| run.to <= to) else {
                continue;
            };
            let j = run.from.start + to - run.to;
            let values = &half.values[j * half.stride..][..half.stride];
            add(column, &values[j..run.from.end]);
            for later in &half.runs[*next + 1..] {
                add(&mut column[later.to - to..], &values[later.from.clone()]);
            }
        }
    }
}

#[inline(always)]
fn add<T: Value>(target: &mut [T], values: &[T]) {
    let target = &mut target[..values.len()];
    target
        .iter_mut()
        .zip(values)
        .for_each(|(sum, value)| sum.add(*value));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_front_is_the_sum_of_its_halves() {
        // Four variables each, in a front of six and two that pad it.
        let places = [[0, 1, 3, 5], [1, 2, 3, 4]];
        let [rows, count] = [8, 3];
        let parts =
            [1.0, 100.0].map(|unit| (0..16).map(|i| unit * f64::from(i)).collect::<Vec<_>>());
        let lists = places.map(|places| runs(places.into_iter().map(Some), count));
        let halves = [0, 1].map(|i| Left {
            runs: &lists[i],
            values: &parts[i],
            stride: 4,
        });
        let (mut panel, mut rest) = (vec![f64::NAN; rows * count], vec![f64::NAN; 25]);
        assemble((&mut panel, &mut rest), [rows, count], &halves);
        for column in 0..rows {
            for row in column..rows {
                let of = |half: usize| {
                    let at = |place: usize| places[half].iter().position(|p| *p as usize == place);
                    at(row)
                        .zip(at(column))
                        .map_or(0.0, |(i, j)| parts[half][j * 4 + i])
                };
                let found = match column.checked_sub(count) {
                    None => panel[column * rows + row],
                    Some(own) => rest[own * 5 + row - count],
                };
                assert_eq!(found, of(0) + of(1), "{row} {column}");
            }
        }
    }

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
