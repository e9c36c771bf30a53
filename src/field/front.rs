//! One step of the elimination: a dense block of pixels, and what it leaves to later ones.

use super::dissection::{Dissection, Region};
use super::{Grid, Sites};
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::matmul::triangular::{BlockStructure, matmul};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Accum, Mat, MatMut, MatRef, Par};

/// Regions with more points eliminate these, and bring in the columns instead.
const MOST_POINTS: usize = 150;

/// Halves of larger regions are eliminated in parallel.
const FORK: usize = 2048;

/// Variables are pixels, then columns.
#[derive(Clone, Debug)]
pub(super) struct Front {
    eliminated: Vec<u32>,
    /// Later variables that these depend on.
    kept: Vec<u32>,
    /// The columns of the Cholesky factor: rows `eliminated`, then `kept`.
    factor: Mat<f64>,
}

/// What is left of a region.
pub(super) struct Part {
    /// In the order of elimination.
    pub(super) fronts: Vec<Front>,
    pub(super) log_determinant: f64,
    /// The equations of `kept` that the region leaves, lower half.
    pub(super) rest: Mat<f64>,
    kept: Vec<u32>,
    /// Whether the columns are among `kept`.
    joined: bool,
}

/// What all regions share.
#[derive(Clone, Copy)]
pub(super) struct Parent<'a> {
    pub(super) grid: &'a Grid<'a>,
    pub(super) sites: &'a Sites<'a>,
    pub(super) cuts: &'a Dissection,
}

impl Parent<'_> {
    /// Eliminates a region. `places` has room for every variable, its values do not matter.
    pub(super) fn eliminate(&self, region: Region, places: &mut [u32]) -> Option<Part> {
        let (halves, own) = match region.cut() {
            None => (None, region),
            Some(([one, two], line)) => (Some(self.both(region, one, two, places)?), line),
        };
        let halves: Vec<Part> = halves.into_iter().flatten().collect();
        let columns = self.sites.seen.count;
        let pixels = self.cuts.len() as u32;
        let whole = region.area() == self.cuts.len();

        let mine: Vec<u32> = self.cuts.pixels(own).collect();
        let turn = self.cuts.turn(mine[0]);
        let (mut points, mut eliminated): (Vec<u32>, Vec<u32>) =
            mine.iter().partition(|&&p| self.place(p).is_some());
        let mut later = Vec::new();
        for &variable in halves.iter().flat_map(|half| &half.kept) {
            if variable < pixels {
                match self.cuts.turn(variable) {
                    other if other < turn => points.push(variable),
                    other if other > turn => later.push(variable),
                    _ => {}
                }
            }
        }
        for &pixel in &mine {
            self.neighbours(pixel, |other, _| {
                if self.cuts.turn(other) > turn {
                    later.push(other);
                }
            });
        }
        later.sort_unstable();
        later.dedup();
        let mut kept = later;
        let joined =
            whole || points.len() > MOST_POINTS || halves.iter().any(|half| half.joined);
        if joined {
            eliminated.extend_from_slice(&points);
            kept.extend((0..columns as u32).map(|column| pixels + column));
        } else {
            kept.extend_from_slice(&points);
        }

        for (place, &variable) in eliminated.iter().chain(&kept).enumerate() {
            places[variable as usize] = place as u32;
        }
        let place = |variable: u32| places[variable as usize] as usize;
        let size = eliminated.len() + kept.len();
        let mut equations = Mat::<f64>::zeros(size, size);
        for &pixel in &mine {
            self.neighbours(pixel, |other, strength| {
                let order = self.cuts.turn(other).cmp(&turn);
                if order.then(other.cmp(&pixel)).is_gt() {
                    let (i, j) = (place(pixel), place(other));
                    equations[(i, i)] += strength;
                    equations[(j, j)] += strength;
                    equations[(i.max(j), i.min(j))] -= strength;
                }
            });
        }
        let mut fronts = Vec::new();
        let mut log_determinant = 0.0;
        for half in halves {
            add(&mut equations, &half, place);
            log_determinant += half.log_determinant;
            if fronts.is_empty() {
                fronts = half.fronts;
            } else {
                fronts.extend(half.fronts);
            }
        }
        if joined {
            let first = size - columns;
            self.observe(&mut equations, &points, place, first);
        }
        let count = eliminated.len();
        factorise(equations.as_mut(), count)?;
        let factor = equations.get(.., ..count).to_owned();
        log_determinant += (0..count).map(|i| 2.0 * factor[(i, i)].ln()).sum::<f64>();
        let rest = equations.get(count.., count..).to_owned();
        fronts.push(Front {
            eliminated,
            kept: kept.clone(),
            factor,
        });
        Some(Part {
            fronts,
            log_determinant,
            rest,
            kept,
            joined,
        })
    }

    fn both(
        &self,
        region: Region,
        one: Region,
        two: Region,
        places: &mut [u32],
    ) -> Option<[Part; 2]> {
        if region.area() <= FORK {
            return Some([self.eliminate(one, places)?, self.eliminate(two, places)?]);
        }
        let room = places.len();
        let (one, two) = rayon::join(
            || self.eliminate(one, places),
            || self.eliminate(two, &mut vec![0; room]),
        );
        Some([one?, two?])
    }

    /// The place of the point at a pixel.
    fn place(&self, pixel: u32) -> Option<usize> {
        (self.sites.places[pixel as usize] as usize).checked_sub(1)
    }

    /// Adds what points say: `weight (y - column x)^2` each.
    fn observe(
        &self,
        equations: &mut Mat<f64>,
        points: &[u32],
        place: impl Fn(u32) -> usize,
        first: usize,
    ) {
        let seen = self.sites.seen;
        let columns = seen.count;
        let mut rows = Mat::<f64>::zeros(columns, points.len());
        for (j, &pixel) in points.iter().enumerate() {
            let Some(point) = self.place(pixel) else {
                continue;
            };
            let (weight, at) = (seen.weights[point], place(pixel));
            equations[(at, at)] += weight;
            for (i, &value) in seen.columns[point * columns..][..columns].iter().enumerate() {
                equations[(first + i, at)] -= weight * value;
                rows[(i, j)] = weight.sqrt() * value;
            }
        }
        let block = equations.get_mut(first.., first..);
        add_product(block, rows.as_ref(), 1.0);
    }

    fn neighbours(&self, pixel: u32, mut visit: impl FnMut(u32, f64)) {
        let Grid {
            height,
            width,
            right,
            down,
        } = *self.grid;
        let at = pixel as usize;
        let (x, y) = (at % width, at / width);
        if x > 0 {
            visit(pixel - 1, right[at - 1]);
        }
        if x + 1 < width {
            visit(pixel + 1, right[at]);
        }
        if y > 0 {
            visit(pixel - width as u32, down[at - width]);
        }
        if y + 1 < height {
            visit(pixel + width as u32, down[at]);
        }
    }
}

/// Adds what a half leaves.
fn add(equations: &mut Mat<f64>, half: &Part, place: impl Fn(u32) -> usize) {
    let places: Vec<usize> = half.kept.iter().map(|&variable| place(variable)).collect();
    for (column, &j) in places.iter().enumerate() {
        let values = &half.rest.col_as_slice(column)[column..];
        for (value, &i) in values.iter().zip(&places[column..]) {
            equations[(i.max(j), i.min(j))] += value;
        }
    }
}

/// Cholesky of the first `count` columns; the rest becomes its Schur complement.
fn factorise(equations: MatMut<'_, f64>, count: usize) -> Option<()> {
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

/// `block += scale rows rows^T`, lower half.
fn add_product(block: MatMut<'_, f64>, rows: MatRef<'_, f64>, scale: f64) {
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

impl Front {
    pub(super) fn forward(&self, values: &mut [f64]) {
        let count = self.eliminated.len();
        for (j, &variable) in self.eliminated.iter().enumerate() {
            let column = &self.factor.col_as_slice(j)[j..];
            let value = values[variable as usize] / column[0];
            values[variable as usize] = value;
            let later = self.eliminated[j + 1..].iter().chain(&self.kept);
            for (&other, factor) in later.zip(&column[1..]) {
                values[other as usize] -= factor * value;
            }
        }
        debug_assert!(count <= self.factor.nrows());
    }

    pub(super) fn backward(&self, values: &mut [f64], later: &mut Vec<f64>) {
        let size = self.factor.nrows();
        later.clear();
        later.resize(size, 0.0);
        let count = self.eliminated.len();
        for (value, &variable) in later[count..].iter_mut().zip(&self.kept) {
            *value = values[variable as usize];
        }
        for (j, &variable) in self.eliminated.iter().enumerate().rev() {
            let column = &self.factor.col_as_slice(j)[j..];
            let known = dot(&column[1..], &later[j + 1..]);
            later[j] = (values[variable as usize] - known) / column[0];
            values[variable as usize] = later[j];
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
