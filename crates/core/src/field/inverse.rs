//! Selected inversion (Takahashi et al. 1973): computes only the entries of the inverse at neighbouring pixels, from a Cholesky
//! factor.
//!
//! Inversion proceeds in the reverse order of elimination. With the columns `L_JJ` and `L_IJ` of a separator or a step with the
//! boundary I, and `X = L_IJ L_JJ^-1`, the inverse at its own variables J follows from that at I:
//!
//! > inverse_IJ = -inverse_II X,   inverse_JJ = L_JJ'^-1 L_JJ^-1 - X' inverse_IJ

use super::factor::{Factor, both, free_updates};
use super::plan::{Child, FORK, Separator, TileBatch};
use super::stencil::Stencil;
use super::symbolic::{PivotStep, SymbolicFactor};
use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::solve_upper_triangular_in_place;
use faer::{Accum, Mat, MatMut, MatRef, Par};
use lsdc_kernels::cholesky::F64x8;
use lsdc_kernels::simd::Level;
use rayon::prelude::*;

/// Number of rows and columns of a product that are summed at once.
const SUMS: usize = 4;

/// Parts of the inverse.
struct InverseParts {
    /// The values at the entries of each separator.
    separators: Vec<(usize, Vec<f64>)>,
    /// The inverse at the ring of each tile.
    rings: Vec<(usize, Mat<f64>)>,
}

impl Factor {
    /// The inverse at every pixel and its neighbours.
    pub(super) fn inverse(&self) -> Stencil {
        let plan = &*self.plan;
        // Rings and fronts need as much memory as the update matrices of a factor.
        free_updates();
        let mut inverse = Stencil::zeros(plan.height, plan.width);
        let found = match plan.root {
            Child::Tile(tile) => {
                let ring = plan.symbolic(tile).ring.len();
                InverseParts {
                    separators: Vec::new(),
                    rings: vec![(tile, Mat::zeros(ring, ring))],
                }
            }
            Child::Separator(root) => self.invert(root, Mat::zeros(0, 0).as_ref()),
        };
        for (separator, values) in &found.separators {
            let entries = plan.separators[*separator].entries.iter();
            for (&(_, _, entry, place), value) in entries.zip(values) {
                inverse.map_mut(entry)[place as usize] = *value;
            }
        }
        let mut rings: Vec<Option<Mat<f64>>> = vec![None; plan.tiles.len()];
        for (tile, ring) in found.rings {
            rings[tile] = Some(ring);
        }
        let batches = plan.batches.par_iter();
        let values: Vec<Vec<F64x8>> = batches
            .map_init(Vec::new, |workspace, batch| {
                self.invert_tiles(batch, &rings, workspace)
            })
            .collect();
        for (batch, values) in plan.batches.iter().zip(&values) {
            let sources = &plan.symbolic_factors[batch.symbolic].sources;
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

    /// Inverts a separator, and all below it; `of_boundary` is the inverse at its boundary.
    fn invert(&self, at: usize, of_boundary: MatRef<'_, f64>) -> InverseParts {
        let separator = &self.plan.separators[at];
        let front = self.front(separator, of_boundary);
        let entries = separator.entries.iter();
        let values = entries.map(|&(row, column, ..)| front[(row as usize, column as usize)]);
        let mut found = InverseParts {
            separators: vec![(at, values.collect())],
            rings: Vec::new(),
        };
        let child = |child: usize| {
            let length = separator.places[child].len();
            let mut part = Mat::zeros(length, length);
            for columns in &separator.runs[child] {
                for (j, to) in columns.from.clone().zip(columns.to..) {
                    let (target, source) = (part.col_as_slice_mut(j), front.col_as_slice(to));
                    for rows in &separator.runs[child] {
                        let values = &source[rows.to..][..rows.from.len()];
                        target[rows.from.clone()].copy_from_slice(values);
                    }
                }
            }
            match separator.children[child] {
                Child::Separator(separator) => self.invert(separator, part.as_ref()),
                Child::Tile(tile) => InverseParts {
                    separators: Vec::new(),
                    rings: vec![(tile, part)],
                },
            }
        };
        let (one, two) = both(separator.tiles > FORK, || child(0), || child(1));
        for child in [one, two] {
            found.separators.extend(child.separators);
            found.rings.extend(child.rings);
        }
        found
    }

    /// Returns the inverse at the variables of a separator and its boundary, given the inverse at the boundary.
    fn front(&self, separator: &Separator, of_boundary: MatRef<'_, f64>) -> Mat<f64> {
        let (count, boundary_count) = (separator.own.len(), separator.boundary.len());
        let columns =
            MatRef::from_column_major_slice(self.columns(separator), separator.rows, count);
        let lower = columns.get(..count, ..);
        let below = columns.get(count..count + boundary_count, ..);
        // L_JJ'^-1.
        let mut inverse = Mat::<f64>::identity(count, count);
        let upper = lower.transpose();
        solve_upper_triangular_in_place(upper, inverse.as_mut(), Par::Seq);
        let mut x = Mat::<f64>::zeros(boundary_count, count);
        product(x.as_mut(), below, inverse.transpose(), 1.0);
        let mut front = Mat::zeros(count + boundary_count, count + boundary_count);
        let (mut own, mut right, mut left, mut last) = front.as_mut().split_at_mut(count, count);
        product(left.as_mut(), of_boundary, x.as_ref(), -1.0);
        right.copy_from(left.as_ref().transpose());
        product(own.as_mut(), inverse.as_ref(), inverse.transpose(), 1.0);
        product(own, right.as_ref(), x.as_ref(), -1.0);
        last.copy_from(of_boundary);
        front
    }

    /// The inverse of up to eight tiles at the sources of their program, from that at their rings.
    fn invert_tiles(
        &self,
        batch: &TileBatch,
        rings: &[Option<Mat<f64>>],
        workspace: &mut Vec<F64x8>,
    ) -> Vec<F64x8> {
        let symbolic = &self.plan.symbolic_factors[batch.symbolic];
        let factor = &self.tiles[batch.factor..][..symbolic.length];
        let count = symbolic.ring.len();
        let mut ring = vec![[0.0; 8]; count * count];
        for (lane, &tile) in batch.tiles.iter().enumerate() {
            let values = rings[tile].iter().flat_map(Mat::col_iter);
            for (column, values) in ring.chunks_exact_mut(count.max(1)).zip(values) {
                let pairs = column.iter_mut().zip(values.iter());
                pairs.for_each(|(own, value)| own[lane] = *value);
            }
        }
        let mut found = vec![[0.0; 8]; symbolic.sources.len()];
        let last = symbolic.steps.len() - 1;
        workspace.resize(symbolic.fronts(last), [0.0; 8]);
        symbolic.invert(last, self.level, factor, &ring, &mut found, workspace);
        found
    }
}

/// Adds the product of two matrices times a factor.
fn product(target: MatMut<'_, f64>, left: MatRef<'_, f64>, right: MatRef<'_, f64>, factor: f64) {
    matmul(target, Accum::Add, left, right, factor, Par::Seq);
}

impl SymbolicFactor {
    /// Returns the number of values needed by a step and all steps below it.
    fn fronts(&self, at: usize) -> usize {
        let step = &self.steps[at];
        let part =
            |&(child, _): &(usize, _)| self.steps[child].boundary.len().pow(2) + self.fronts(child);
        let parts = step.children.iter().map(part).max().unwrap_or(0);
        step.front().pow(2) + step.count * step.boundary.len() + parts
    }

    /// Inverts a step and all below it, eight tiles at once; `of_boundary` is the inverse at its
    /// boundary.
    fn invert(
        &self,
        at: usize,
        level: Level,
        factor: &[F64x8],
        of_boundary: &[F64x8],
        found: &mut [F64x8],
        workspace: &mut [F64x8],
    ) {
        let step = &self.steps[at];
        let rows = step.front();
        let (front, workspace) = workspace.split_at_mut(rows * rows);
        let (x, workspace) = workspace.split_at_mut(step.count * step.boundary.len());
        level.vectorised(
            #[inline(always)]
            || step.invert(factor, of_boundary, front, x),
        );
        for &[row, column, source] in &step.entries {
            found[source as usize] = front[column as usize * rows + row as usize];
        }
        for (child, runs) in &step.children {
            let length = self.steps[*child].boundary.len();
            let (part, workspace) = workspace.split_at_mut(length * length);
            for columns in runs {
                for (j, to) in columns.from.clone().zip(columns.to..) {
                    let (target, source) = (&mut part[j * length..], &front[to * rows..]);
                    for run in runs {
                        let values = &source[run.to..][..run.from.len()];
                        target[run.from.clone()].copy_from_slice(values);
                    }
                }
            }
            self.invert(*child, level, factor, part, found, workspace);
        }
    }
}

impl PivotStep {
    /// Returns the number of its eliminated variables and of its boundary.
    fn front(&self) -> usize {
        self.count + self.boundary.len()
    }

    /// The inverse `[rows, rows]` at its own variables and its boundary, where it is `of_boundary`. X is `[boundary,
    /// own]`, here too column by column.
    #[inline(always)]
    fn invert(
        &self,
        factor: &[F64x8],
        of_boundary: &[F64x8],
        front: &mut [F64x8],
        x: &mut [F64x8],
    ) {
        let (count, boundary_count, rows) = (self.count, self.boundary.len(), self.front());
        for (j, column) in of_boundary.chunks_exact(boundary_count.max(1)).enumerate() {
            front[(count + j) * rows + count..][..boundary_count].copy_from_slice(column);
        }
        // X, and L_JJ^-1 in the place of the inverse, from the last column on.
        for j in (0..count).rev() {
            let factors = self.column(factor, j);
            let scale = factors[j].map(f64::recip);
            let (own, later) = x[j * boundary_count..].split_at_mut(boundary_count);
            for (x, factor) in own.iter_mut().zip(&factors[count..]) {
                *x = *factor;
            }
            for (i, later) in (j + 1..count).zip(later.chunks_exact(boundary_count.max(1))) {
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
            for at in (0..boundary_count).step_by(SUMS) {
                let other: [usize; SUMS] =
                    std::array::from_fn(|i| (at + i).min(boundary_count - 1));
                let mut sums = [[[0.0; 8]; SUMS]; SUMS];
                for k in 0..boundary_count {
                    let known = other.map(|i| of_boundary[k * boundary_count + i]);
                    for (sums, j) in sums.iter_mut().zip(own) {
                        let factor = x[j * boundary_count + k];
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
        // Written to the upper half, to preserve the columns of L_JJ^-1 that are still needed.
        for j in 0..count {
            for i in j..count {
                let mut sum = [0.0; 8];
                for k in i..count {
                    let (one, other) = (front[j * rows + k], front[i * rows + k]);
                    let terms = sum.iter_mut().zip(&one).zip(&other);
                    terms.for_each(|((sum, one), other)| *sum += one * other);
                }
                for k in 0..boundary_count {
                    subtract(
                        &mut sum,
                        &x[j * boundary_count + k],
                        &front[i * rows + count + k],
                    );
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
fn subtract(value: &mut F64x8, factor: &F64x8, other: &F64x8) {
    let terms = value.iter_mut().zip(factor).zip(other);
    terms.for_each(|((value, factor), other)| *value -= factor * other);
}

#[inline(always)]
fn multiply(value: &mut F64x8, factor: &F64x8) {
    let pairs = value.iter_mut().zip(factor);
    pairs.for_each(|(value, factor)| *value *= factor);
}
