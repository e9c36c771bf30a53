//! One step of the elimination: a dense block of pixels, and what it leaves to later ones.

use super::columns::Columns;
use super::dissection::{Dissection, Region};
use super::{Grid, Sites};
use crate::simd::Level;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::matmul::triangular::{BlockStructure, matmul};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Accum, Mat, MatMut, MatRef, Par};

/// Regions with more points eliminate these, and bring in the columns instead.
const MOST_POINTS: usize = 150;

/// Halves of larger regions are eliminated in parallel.
const FORK: usize = 2048;

/// Larger fronts are worth blocked algorithms.
const SMALL: usize = 160;

/// Variables are pixels, then columns.
#[derive(Clone, Debug)]
pub(super) struct Front {
    pub(super) eliminated: Vec<u32>,
    /// Later variables that these depend on: pixels, then columns.
    kept: Vec<u32>,
    /// The columns of the Cholesky factor: rows `eliminated`, then `kept`.
    pub(super) factor: Columns,
    /// Whether the columns are among `kept`.
    pub(super) joined: bool,
    /// Where each of `kept`, but for columns, is in the front of the whole that this is a half of:
    /// among its eliminated, then its kept.
    pub(super) inherited: Vec<u32>,
    /// How many fronts directly before this one are of its halves.
    pub(super) descendants: usize,
    columns: usize,
}

/// What is left of a region.
pub(super) struct Part {
    /// In the order of elimination.
    pub(super) fronts: Vec<Front>,
    pub(super) log_determinant: f64,
    /// The equations of `kept` that the region leaves, lower half.
    pub(super) rest: Columns,
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
    pub(super) level: Level,
}

/// Memory that the fronts of a thread use one after the other. Its values do not matter.
pub(super) struct Room {
    /// Where each variable is in a front.
    places: Vec<u32>,
    /// A front, column by column.
    equations: Vec<f64>,
}

impl Room {
    pub(super) fn new(variables: usize) -> Self {
        Self {
            places: vec![0; variables],
            equations: Vec::new(),
        }
    }

    /// A front with nothing in its lower half.
    fn clear(&mut self, size: usize) {
        if self.equations.len() < size * size {
            self.equations.resize(size * size, 0.0);
        }
        for (j, column) in self
            .equations
            .chunks_exact_mut(size.max(1))
            .take(size)
            .enumerate()
        {
            column[j..].fill(0.0);
        }
    }
}

/// A square matrix of which the lower half counts, column by column.
struct Lower<'a> {
    values: &'a mut [f64],
    size: usize,
}

impl Lower<'_> {
    fn add(&mut self, i: usize, j: usize, value: f64) {
        self.values[i.min(j) * self.size + i.max(j)] += value;
    }
}

impl Parent<'_> {
    /// Eliminates a region.
    pub(super) fn eliminate(&self, region: Region, room: &mut Room) -> Option<Part> {
        let (halves, own) = match region.cut() {
            None => (None, region),
            Some(([one, two], line)) => (Some(self.both(region, one, two, room)?), line),
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
        let joined = whole || points.len() > MOST_POINTS || halves.iter().any(|half| half.joined);
        if joined {
            eliminated.extend_from_slice(&points);
            kept.extend((0..columns as u32).map(|column| pixels + column));
        } else {
            kept.extend_from_slice(&points);
        }

        for (place, &variable) in eliminated.iter().chain(&kept).enumerate() {
            room.places[variable as usize] = place as u32;
        }
        let (count, size) = (eliminated.len(), eliminated.len() + kept.len());
        room.clear(size);
        let Room { places, equations } = room;
        let place = |variable: u32| places[variable as usize] as usize;
        let mut lower = Lower {
            values: &mut equations[..size * size],
            size,
        };
        for &pixel in &mine {
            self.neighbours(pixel, |other, strength| {
                let order = self.cuts.turn(other).cmp(&turn);
                if order.then(other.cmp(&pixel)).is_gt() {
                    let (i, j) = (place(pixel), place(other));
                    lower.add(i, i, strength);
                    lower.add(j, j, strength);
                    lower.add(i, j, -strength);
                }
            });
        }
        let mut fronts = Vec::new();
        let mut log_determinant = 0.0;
        for mut half in halves {
            half.add_to(&mut lower, place);
            log_determinant += half.log_determinant;
            if fronts.is_empty() {
                fronts = half.fronts;
            } else {
                fronts.extend(half.fronts);
            }
        }
        if joined {
            self.observe(&mut lower, &points, place, size - columns);
        }
        factorise(lower.values, size, count, self.level)?;
        let factor = Columns::of(lower.values, size, 0..count);
        log_determinant += (0..count)
            .map(|i| 2.0 * factor.column(i)[0].ln())
            .sum::<f64>();
        let rest = Columns::of(lower.values, size, count..size);
        let descendants = fronts.len();
        fronts.push(Front {
            eliminated,
            kept: kept.clone(),
            factor,
            joined,
            inherited: Vec::new(),
            descendants,
            columns: if joined { columns } else { 0 },
        });
        Some(Part {
            fronts,
            log_determinant,
            rest,
            kept,
            joined,
        })
    }

    fn both(&self, region: Region, one: Region, two: Region, room: &mut Room) -> Option<[Part; 2]> {
        if region.area() <= FORK {
            return Some([self.eliminate(one, room)?, self.eliminate(two, room)?]);
        }
        let variables = room.places.len();
        let (one, two) = rayon::join(
            || self.eliminate(one, room),
            || self.eliminate(two, &mut Room::new(variables)),
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
        lower: &mut Lower<'_>,
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
            lower.add(at, at, weight);
            let values = &seen.columns[point * columns..][..columns];
            for (i, &value) in values.iter().enumerate() {
                lower.add(first + i, at, -weight * value);
            }
            let row = rows.col_as_slice_mut(j).iter_mut();
            row.zip(values).for_each(|(r, v)| *r = weight.sqrt() * v);
        }
        let size = lower.size;
        let all = MatMut::from_column_major_slice_mut(lower.values, size, size);
        let (_, _, _, block) = all.split_at_mut(first, first);
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

impl Part {
    /// Adds what the region leaves, and tells its front where.
    fn add_to(&mut self, lower: &mut Lower<'_>, place: impl Fn(u32) -> usize) {
        let places: Vec<usize> = self.kept.iter().map(|&variable| place(variable)).collect();
        for (column, &j) in places.iter().enumerate() {
            let values = self.rest.column(column);
            for (&value, &i) in values.iter().zip(&places[column..]) {
                lower.add(i, j, value);
            }
        }
        if let Some(front) = self.fronts.last_mut() {
            let pixels = front.kept_pixels().len();
            front.inherited = places[..pixels].iter().map(|&place| place as u32).collect();
        }
    }
}

/// Cholesky of the first `count` columns; the rest becomes its Schur complement.
fn factorise(values: &mut [f64], size: usize, count: usize, level: Level) -> Option<()> {
    if size <= SMALL {
        return level.vectorised(
            #[inline(always)]
            || eliminate_by_columns(values, size, count),
        );
    }
    let equations = MatMut::from_column_major_slice_mut(values, size, size);
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

/// The same, without what is 0: in small fronts most pixels are not joined yet. A few columns at
/// once, which spares memory traffic.
#[inline(always)]
fn eliminate_by_columns(values: &mut [f64], size: usize, count: usize) -> Option<()> {
    const TOGETHER: usize = 4;
    let mut first = 0;
    while first < count {
        let end = (first + TOGETHER).min(count);
        for j in first..end {
            let (known, later) = values.split_at_mut((j + 1) * size);
            let column = &mut known[j * size + j..];
            let pivot = column[0];
            if !(pivot > 0.0 && pivot.is_finite()) {
                return None;
            }
            let scale = pivot.sqrt().recip();
            column.iter_mut().for_each(|v| *v *= scale);
            for (k, target) in later.chunks_exact_mut(size).take(end - j - 1).enumerate() {
                let own = &column[k + 1..];
                let factor = own[0];
                let targets = target[j + k + 1..].iter_mut();
                targets.zip(own).for_each(|(t, v)| *t -= factor * v);
            }
        }
        let (known, later) = values.split_at_mut(end * size);
        let column = |j: usize| &known[j.min(end - 1) * size..][..size];
        let block: [&[f64]; TOGETHER] = std::array::from_fn(|i| column(first + i));
        for (k, target) in (end..).zip(later.chunks_exact_mut(size)) {
            let factors: [f64; TOGETHER] =
                std::array::from_fn(|i| if first + i < end { block[i][k] } else { 0.0 });
            if factors == [0.0; TOGETHER] {
                continue;
            }
            let [a, b, c, d] = block.map(|column| &column[k..]);
            let target = &mut target[k..];
            let length = target.len();
            let (a, b, c, d) = (&a[..length], &b[..length], &c[..length], &d[..length]);
            for (i, target) in target.iter_mut().enumerate() {
                let sum = factors[0] * a[i] + factors[1] * b[i];
                *target -= sum + (factors[2] * c[i] + factors[3] * d[i]);
            }
        }
        first = end;
    }
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
