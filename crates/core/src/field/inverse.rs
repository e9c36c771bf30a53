//! Selected inversion (Takahashi et al. 1973): the entries of the inverse at pixels that are joined, from a
//! Cholesky factor, without the others.
//!
//! What is eliminated last is inverted first. With the columns `L_JJ` and `L_IJ` of a line or a step, which keeps
//! the variables I, and `X = L_IJ L_JJ^-1`, the inverse at its own variables J follows from that at I:
//!
//! > inverse_IJ = -inverse_II X,   inverse_JJ = L_JJ'^-1 L_JJ^-1 - X' inverse_IJ
//!
//! Tiles do the same, column by column.

use super::factor::{Factor, both};
use super::plan::{Batch, FORK, Half};
use super::stencil::Stencil;
use super::tile::{Program, Step};
use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::{
    solve_lower_triangular_in_place, solve_upper_triangular_in_place,
};
use faer::{Accum, Mat, MatRef, Par};
use lsdc_kernels::cholesky::Eight;
use lsdc_kernels::simd::Level;
use rayon::prelude::*;

/// Sums of a column of a tile that are made at once.
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
            .map(|batch| self.invert_tiles(batch, &rings))
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
        let (count, rest) = (line.own.len(), line.kept.len());
        let columns = MatRef::from_column_major_slice(self.columns(line), line.rows, count);
        let (lower, below) = (
            columns.get(..count, ..),
            columns.get(count..count + rest, ..),
        );
        let mut front = Mat::zeros(count + rest, count + rest);
        let (mut own, mut right, mut left, mut last) = front.as_mut().split_at_mut(count, count);
        // X'.
        let mut x = below.transpose().to_owned();
        solve_upper_triangular_in_place(lower.transpose(), x.as_mut(), Par::Seq);
        matmul(right.as_mut(), Accum::Replace, &x, kept, -1.0, Par::Seq);
        left.copy_from(right.as_ref().transpose());
        own.copy_from(Mat::<f64>::identity(count, count));
        solve_lower_triangular_in_place(lower, own.as_mut(), Par::Seq);
        solve_upper_triangular_in_place(lower.transpose(), own.as_mut(), Par::Seq);
        matmul(own, Accum::Add, right, x.transpose(), -1.0, Par::Seq);
        last.copy_from(kept);
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

    /// The inverse of up to eight tiles at the sources of their program, from that at their rings.
    fn invert_tiles(&self, batch: &Batch, rings: &[Option<Mat<f64>>]) -> Vec<Eight> {
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
        program.invert(
            program.steps.len() - 1,
            self.level,
            factor,
            &ring,
            &mut found,
        );
        found
    }
}

impl Program {
    /// Inverts a step and all below it, eight tiles at once; `kept` is the inverse at the variables that it
    /// keeps.
    fn invert(
        &self,
        at: usize,
        level: Level,
        factor: &[Eight],
        kept: &[Eight],
        found: &mut [Eight],
    ) {
        let step = &self.steps[at];
        let (count, rest) = (step.count, step.kept.len());
        let rows = count + rest;
        let mut front = vec![[0.0; 8]; rows * rows];
        for j in 0..rest {
            front[(count + j) * rows + count..][..rest].copy_from_slice(&kept[j * rest..][..rest]);
        }
        level.vectorised(
            #[inline(always)]
            || step.invert(factor, rows, &mut front),
        );
        for &[row, column, source] in &step.entries {
            found[source as usize] = front[column as usize * rows + row as usize];
        }
        for (half, runs) in &step.halves {
            let places = runs.iter().flat_map(|run| run.to..run.to + run.from.len());
            let places: Vec<usize> = places.collect();
            let columns = places.iter().map(|&place| &front[place * rows..][..rows]);
            let part = columns.flat_map(|column| places.iter().map(|&place| column[place]));
            self.invert(*half, level, factor, &part.collect::<Vec<_>>(), found);
        }
    }
}

impl Step {
    /// Fills in the columns of its own variables, of which each follows from the later ones.
    #[inline(always)]
    fn invert(&self, factor: &[Eight], rows: usize, front: &mut [Eight]) {
        for j in (0..self.count).rev() {
            let factors = &self.column(factor, j)[..rows];
            // A few at a time, whose sums do not wait for each other.
            for first in (j + 1..rows).step_by(SUMS) {
                let each: [usize; SUMS] = std::array::from_fn(|i| (first + i).min(rows - 1));
                let known = each.map(|i| &front[i * rows..][..rows]);
                let mut sums = [[0.0; 8]; SUMS];
                for k in j + 1..rows {
                    for (sum, known) in sums.iter_mut().zip(known) {
                        subtract(sum, &factors[k], &known[k]);
                    }
                }
                for (i, mut sum) in each.into_iter().zip(sums) {
                    divide(&mut sum, &factors[j]);
                    front[j * rows + i] = sum;
                    front[i * rows + j] = sum;
                }
            }
            let mut own = [1.0; 8];
            divide(&mut own, &factors[j]);
            for k in j + 1..rows {
                subtract(&mut own, &factors[k], &front[j * rows + k]);
            }
            divide(&mut own, &factors[j]);
            front[j * rows + j] = own;
        }
    }
}

#[inline(always)]
fn subtract(value: &mut Eight, factor: &Eight, other: &Eight) {
    let pairs = value.iter_mut().zip(factor).zip(other);
    pairs.for_each(|((value, factor), other)| *value -= factor * other);
}

#[inline(always)]
fn divide(value: &mut Eight, divisor: &Eight) {
    let pairs = value.iter_mut().zip(divisor);
    pairs.for_each(|(value, divisor)| *value /= divisor);
}
