//! Selected inversion (Takahashi et al. 1973): the entries of the inverse at pixels that are joined, from a
//! Cholesky factor, without the others.
//!
//! What is eliminated last is inverted first. With the columns `L_JJ` and `L_IJ` of a line or a step, which keeps
//! the variables I, and `X = L_IJ L_JJ^-1`, the inverse at its own variables J follows from that at I:
//!
//! > inverse_IJ = -inverse_II X,   inverse_JJ = L_JJ'^-1 L_JJ^-1 - X' inverse_IJ

use super::factor::{Factor, both, forget_rests};
use super::plan::{Batch, FORK, Half, Line};
use super::stencil::Stencil;
use super::symbolic::{PivotStep, SymbolicFactor};
use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::solve_upper_triangular_in_place;
use faer::{Accum, Mat, MatMut, MatRef, Par};
use lsdc_kernels::cholesky::Eight;
use lsdc_kernels::simd::Level;
use rayon::prelude::*;

/// Rows and columns of a product that are summed at once.
const SUMS: usize = 4;

/// What is found for lines.
struct Found {
    /// The values at the entries of each line.
    lines: Vec<(usize, Vec<f64>)>,
    /// The inverse at the ring of each tile.
    rings: Vec<(usize, Mat<f64>)>,
}

impl Factor {
    /// The inverse at every pixel and its neighbours.
    pub(super) fn inverse(&self) -> Stencil {
        let plan = &*self.plan;
        // Rings and fronts are as large as what is left while a factor is made.
        forget_rests();
        let mut inverse = Stencil::zeros(plan.height, plan.width);
        let found = match plan.root {
            Half::Tile(tile) => {
                let ring = plan.program(tile).ring.len();
                Found {
                    lines: Vec::new(),
                    rings: vec![(tile, Mat::zeros(ring, ring))],
                }
            }
            Half::Line(root) => self.invert(root, Mat::zeros(0, 0).as_ref()),
        };
        for (line, values) in &found.lines {
            let entries = plan.lines[*line].entries.iter();
            for (&(_, _, entry, place), value) in entries.zip(values) {
                inverse.map_mut(entry)[place as usize] = *value;
            }
        }
        let mut rings: Vec<Option<Mat<f64>>> = vec![None; plan.tiles.len()];
        for (tile, ring) in found.rings {
            rings[tile] = Some(ring);
        }
        let batches = plan.batches.par_iter();
        let values: Vec<Vec<Eight>> = batches
            .map_init(Vec::new, |room, batch| {
                self.invert_tiles(batch, &rings, room)
            })
            .collect();
        for (batch, values) in plan.batches.iter().zip(&values) {
            let sources = &plan.programs[batch.program].sources;
            for (lane, &tile) in batch.tiles.iter().enumerate() {
                let tile = &plan.tiles[tile];
                let first = inverse.place(tile.left, tile.top);
                for (source, value) in sources.iter().zip(values) {
                    let place = first.wrapping_add_signed(inverse.offset(source.x, source.y));
                    inverse.map_mut(source.entry)[place] = value[lane];
                }
            }
        }
        inverse
    }

    /// Inverts a line, and all below it; `kept` is the inverse at the variables that it keeps.
    fn invert(&self, at: usize, kept: MatRef<'_, f64>) -> Found {
        let line = &self.plan.lines[at];
        let front = self.front(line, kept);
        let entries = line.entries.iter();
        let values = entries.map(|&(row, column, ..)| front[(row as usize, column as usize)]);
        let mut found = Found {
            lines: vec![(at, values.collect())],
            rings: Vec::new(),
        };
        let half = |half: usize| {
            let length = line.places[half].len();
            let mut part = Mat::zeros(length, length);
            for columns in &line.runs[half] {
                for (j, to) in columns.from.clone().zip(columns.to..) {
                    let (target, source) = (part.col_as_slice_mut(j), front.col_as_slice(to));
                    for rows in &line.runs[half] {
                        let values = &source[rows.to..][..rows.from.len()];
                        target[rows.from.clone()].copy_from_slice(values);
                    }
                }
            }
            match line.halves[half] {
                Half::Line(line) => self.invert(line, part.as_ref()),
                Half::Tile(tile) => Found {
                    lines: Vec::new(),
                    rings: vec![(tile, part)],
                },
            }
        };
        let (one, two) = both(line.tiles > FORK, || half(0), || half(1));
        for half in [one, two] {
            found.lines.extend(half.lines);
            found.rings.extend(half.rings);
        }
        found
    }

    /// The inverse at the variables of a line and those that it keeps, where it is `kept`.
    fn front(&self, line: &Line, kept: MatRef<'_, f64>) -> Mat<f64> {
        let (count, rest) = (line.own.len(), line.kept.len());
        let columns = MatRef::from_column_major_slice(self.columns(line), line.rows, count);
        let lower = columns.get(..count, ..);
        let below = columns.get(count..count + rest, ..);
        // L_JJ'^-1.
        let mut inverse = Mat::<f64>::identity(count, count);
        let upper = lower.transpose();
        solve_upper_triangular_in_place(upper, inverse.as_mut(), Par::Seq);
        let mut x = Mat::<f64>::zeros(rest, count);
        product(x.as_mut(), below, inverse.transpose(), 1.0);
        let mut front = Mat::zeros(count + rest, count + rest);
        let (mut own, mut right, mut left, mut last) = front.as_mut().split_at_mut(count, count);
        product(left.as_mut(), kept, x.as_ref(), -1.0);
        right.copy_from(left.as_ref().transpose());
        product(own.as_mut(), inverse.as_ref(), inverse.transpose(), 1.0);
        product(own, right.as_ref(), x.as_ref(), -1.0);
        last.copy_from(kept);
        front
    }

    /// The inverse of up to eight tiles at the sources of their program, from that at their rings.
    fn invert_tiles(
        &self,
        batch: &Batch,
        rings: &[Option<Mat<f64>>],
        room: &mut Vec<Eight>,
    ) -> Vec<Eight> {
        let program = &self.plan.programs[batch.program];
        let factor = &self.tiles[batch.factor..][..program.length];
        let count = program.ring.len();
        let mut ring = vec![[0.0; 8]; count * count];
        for (lane, &tile) in batch.tiles.iter().enumerate() {
            let values = rings[tile].iter().flat_map(Mat::col_iter);
            for (column, values) in ring.chunks_exact_mut(count.max(1)).zip(values) {
                let pairs = column.iter_mut().zip(values.iter());
                pairs.for_each(|(own, value)| own[lane] = *value);
            }
        }
        let mut found = vec![[0.0; 8]; program.sources.len()];
        let last = program.steps.len() - 1;
        room.resize(program.fronts(last), [0.0; 8]);
        program.invert(last, self.level, factor, &ring, &mut found, room);
        found
    }
}

/// Adds the product of two matrices times a factor.
fn product(target: MatMut<'_, f64>, left: MatRef<'_, f64>, right: MatRef<'_, f64>, factor: f64) {
    matmul(target, Accum::Add, left, right, factor, Par::Seq);
}

impl SymbolicFactor {
    /// Values that a step and all below it need.
    fn fronts(&self, at: usize) -> usize {
        let step = &self.steps[at];
        let part = |&(half, _): &(usize, _)| self.steps[half].kept.len().pow(2) + self.fronts(half);
        let parts = step.halves.iter().map(part).max().unwrap_or(0);
        step.front().pow(2) + step.count * step.kept.len() + parts
    }

    /// Inverts a step and all below it, eight tiles at once; `kept` is the inverse at the variables that it
    /// keeps.
    fn invert(
        &self,
        at: usize,
        level: Level,
        factor: &[Eight],
        kept: &[Eight],
        found: &mut [Eight],
        room: &mut [Eight],
    ) {
        let step = &self.steps[at];
        let rows = step.front();
        let (front, room) = room.split_at_mut(rows * rows);
        let (x, room) = room.split_at_mut(step.count * step.kept.len());
        level.vectorised(
            #[inline(always)]
            || step.invert(factor, kept, front, x),
        );
        for &[row, column, source] in &step.entries {
            found[source as usize] = front[column as usize * rows + row as usize];
        }
        for (half, runs) in &step.halves {
            let length = self.steps[*half].kept.len();
            let (part, room) = room.split_at_mut(length * length);
            for columns in runs {
                for (j, to) in columns.from.clone().zip(columns.to..) {
                    let (target, source) = (&mut part[j * length..], &front[to * rows..]);
                    for run in runs {
                        let values = &source[run.to..][..run.from.len()];
                        target[run.from.clone()].copy_from_slice(values);
                    }
                }
            }
            self.invert(*half, level, factor, part, found, room);
        }
    }
}

impl PivotStep {
    /// The variables that it eliminates or keeps.
    fn front(&self) -> usize {
        self.count + self.kept.len()
    }

    /// The inverse `[rows, rows]` at its own variables and those that it keeps, where it is `kept`. X is `[kept,
    /// own]`, here too column by column.
    #[inline(always)]
    fn invert(&self, factor: &[Eight], kept: &[Eight], front: &mut [Eight], x: &mut [Eight]) {
        let (count, rest, rows) = (self.count, self.kept.len(), self.front());
        for (j, column) in kept.chunks_exact(rest.max(1)).enumerate() {
            front[(count + j) * rows + count..][..rest].copy_from_slice(column);
        }
        // X, and L_JJ^-1 in the place of the inverse, from the last column on.
        for j in (0..count).rev() {
            let factors = self.column(factor, j);
            let scale = factors[j].map(f64::recip);
            let (own, later) = x[j * rest..].split_at_mut(rest);
            for (x, factor) in own.iter_mut().zip(&factors[count..]) {
                *x = *factor;
            }
            for (i, later) in (j + 1..count).zip(later.chunks_exact(rest.max(1))) {
                let factor = &factors[i];
                let pairs = own.iter_mut().zip(later);
                pairs.for_each(|(x, later)| subtract(x, factor, later));
            }
            for x in own.iter_mut() {
                multiply(x, &scale);
            }
            front[j * rows + j] = scale;
            for i in j + 1..count {
                let mut sum = [0.0; 8];
                for k in j + 1..=i {
                    subtract(&mut sum, &front[k * rows + i], &factors[k]);
                }
                multiply(&mut sum, &scale);
                front[j * rows + i] = sum;
            }
        }
        // -X' inverse_II.
        for first in (0..count).step_by(SUMS) {
            let own: [usize; SUMS] = std::array::from_fn(|i| (first + i).min(count - 1));
            for at in (0..rest).step_by(SUMS) {
                let other: [usize; SUMS] = std::array::from_fn(|i| (at + i).min(rest - 1));
                let mut sums = [[[0.0; 8]; SUMS]; SUMS];
                for k in 0..rest {
                    let known = other.map(|i| kept[k * rest + i]);
                    for (sums, j) in sums.iter_mut().zip(own) {
                        let factor = x[j * rest + k];
                        for (sum, known) in sums.iter_mut().zip(&known) {
                            subtract(sum, &factor, known);
                        }
                    }
                }
                for (sums, j) in sums.iter().zip(own) {
                    for (sum, i) in sums.iter().zip(other) {
                        front[j * rows + count + i] = *sum;
                        front[(count + i) * rows + j] = *sum;
                    }
                }
            }
        }
        // Into the upper half, so that the columns of L_JJ^-1 that are still needed stay.
        for j in 0..count {
            for i in j..count {
                let mut sum = [0.0; 8];
                for k in i..count {
                    let (one, other) = (front[j * rows + k], front[i * rows + k]);
                    let terms = sum.iter_mut().zip(&one).zip(&other);
                    terms.for_each(|((sum, one), other)| *sum += one * other);
                }
                for k in 0..rest {
                    subtract(&mut sum, &x[j * rest + k], &front[i * rows + count + k]);
                }
                front[i * rows + j] = sum;
            }
        }
        for j in 0..count {
            for i in j..count {
                front[j * rows + i] = front[i * rows + j];
            }
        }
    }
}

#[inline(always)]
fn subtract(value: &mut Eight, factor: &Eight, other: &Eight) {
    let terms = value.iter_mut().zip(factor).zip(other);
    terms.for_each(|((value, factor), other)| *value -= factor * other);
}

#[inline(always)]
fn multiply(value: &mut Eight, factor: &Eight) {
    let pairs = value.iter_mut().zip(factor);
    pairs.for_each(|(value, factor)| *value *= factor);
}
