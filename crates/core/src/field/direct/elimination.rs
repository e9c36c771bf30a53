//! The elimination, region by region: from the leaves to the separating lines between halves.

use super::columns::Columns;
use super::dense::{add_product, factorise};
use super::dissection::{Dissection, Region};
use super::front::Front;
use super::{Grid, Sites};
use faer::{Mat, MatMut};
use lsdc_kernels::simd::Level;

/// Regions with more points than this eliminate them and introduce the columns instead.
const MOST_POINTS: usize = 150;

/// The halves of regions larger than this are eliminated in parallel.
const FORK: usize = 2048;

/// What remains of an eliminated region.
pub(super) struct Part {
    /// In the order of elimination.
    pub(super) fronts: Vec<Front>,
    /// The equations of `kept` that the region leaves, lower half.
    pub(super) rest: Columns,
    kept: Vec<u32>,
    /// Whether the columns are among `kept`.
    joined: bool,
}

/// What all regions share.
#[derive(Clone, Copy)]
pub(super) struct Elimination<'a> {
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

    /// Places the variables of a front, and sets the lower half of its equations to 0.
    fn begin(&mut self, own: &Variables) {
        for (place, &variable) in own.eliminated.iter().chain(&own.kept).enumerate() {
            self.places[variable as usize] = place as u32;
        }
        let (_, size) = own.sizes();
        if self.equations.len() < size * size {
            self.equations.resize(size * size, 0.0);
        }
        let columns = self.equations.chunks_exact_mut(size.max(1));
        for (j, column) in columns.take(size).enumerate() {
            column[j..].fill(0.0);
        }
    }
}

/// What a front is made of.
struct Variables {
    /// Of its line or leaf.
    pixels: Vec<u32>,
    /// The variables of observations that are not eliminated yet.
    points: Vec<u32>,
    /// Those of the line or leaf, less points that are kept.
    eliminated: Vec<u32>,
    /// Later pixels, then points or columns.
    kept: Vec<u32>,
    joined: bool,
}

impl Variables {
    /// The number of those that are eliminated, and of all.
    fn sizes(&self) -> (usize, usize) {
        let count = self.eliminated.len();
        (count, count + self.kept.len())
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

impl Elimination<'_> {
    /// Eliminates a region.
    pub(super) fn eliminate(&self, region: Region, room: &mut Room) -> Option<Part> {
        let (halves, own) = match region.cut() {
            None => (None, region),
            Some(([one, two], line)) => (Some(self.both(region, one, two, room)?), line),
        };
        let halves: Vec<Part> = halves.into_iter().flatten().collect();
        let whole = region.area() == self.cuts.len();
        let own = self.variables(own, &halves, whole);
        let (count, size) = own.sizes();
        room.begin(&own);
        let Room { places, equations } = room;
        let place = |variable: u32| places[variable as usize] as usize;
        let mut lower = Lower {
            values: &mut equations[..size * size],
            size,
        };
        self.join(&mut lower, &own.pixels, place);
        let mut fronts = Vec::new();
        for mut half in halves {
            half.add_to(&mut lower, place);
            if fronts.is_empty() {
                fronts = half.fronts;
            } else {
                fronts.extend(half.fronts);
            }
        }
        let columns = if own.joined { self.sites.seen.count } else { 0 };
        if own.joined {
            self.observe(&mut lower, &own.points, place, size - columns);
        }
        factorise(lower.values, size, count, self.level)?;
        let factor = Columns::of(lower.values, size, 0..count);
        let rest = Columns::of(lower.values, size, count..size);
        let descendants = fronts.len();
        fronts.push(Front {
            eliminated: own.eliminated,
            kept: own.kept.clone(),
            factor,
            joined: own.joined,
            inherited: Vec::new(),
            descendants,
            columns,
        });
        Some(Part {
            fronts,
            rest,
            kept: own.kept,
            joined: own.joined,
        })
    }

    /// What the front of a line or leaf is made of.
    fn variables(&self, own: Region, halves: &[Part], whole: bool) -> Variables {
        let pixels: Vec<u32> = self.cuts.pixels(own).collect();
        let turn = self.cuts.turn(pixels[0]);
        let (mut points, mut eliminated): (Vec<u32>, Vec<u32>) = pixels
            .iter()
            .partition(|&&pixel| self.sites.carried(pixel).is_some());
        let mut later = Vec::new();
        let (grid, all) = (self.cuts.len() as u32, self.sites.variables() as u32);
        for &variable in halves.iter().flat_map(|half| &half.kept) {
            if variable < grid {
                match self.cuts.turn(variable) {
                    other if other < turn => points.push(variable),
                    other if other > turn => later.push(variable),
                    _ => {}
                }
            } else if variable < all {
                points.push(variable);
            }
        }
        for &pixel in &pixels {
            self.neighbours(pixel, |other, _| {
                if self.cuts.turn(other) > turn {
                    later.push(other);
                }
            });
            for (variable, observation) in self.sites.beginning_at(pixel) {
                points.push(variable);
                let around = self.sites.seen.taps[observation].iter();
                later.extend(
                    around
                        .map(|tap| tap.0)
                        .filter(|&p| self.cuts.turn(p) > turn),
                );
            }
        }
        later.sort_unstable();
        later.dedup();
        let mut kept = later;
        let joined = whole || points.len() > MOST_POINTS || halves.iter().any(|half| half.joined);
        if joined {
            eliminated.extend_from_slice(&points);
            kept.extend((0..self.sites.seen.count as u32).map(|column| all + column));
        } else {
            kept.extend_from_slice(&points);
        }
        Variables {
            pixels,
            points,
            eliminated,
            kept,
            joined,
        }
    }

    /// Adds what joins pixels to each other, to later ones, to 0, and to observations between them.
    fn join(&self, lower: &mut Lower<'_>, pixels: &[u32], place: impl Fn(u32) -> usize) {
        for &pixel in pixels {
            let turn = self.cuts.turn(pixel);
            let here = place(pixel);
            lower.add(here, here, self.grid.level);
            self.neighbours(pixel, |other, strength| {
                let order = self.cuts.turn(other).cmp(&turn);
                if order.then(other.cmp(&pixel)).is_gt() {
                    let (i, j) = (here, place(other));
                    lower.add(i, i, strength);
                    lower.add(j, j, strength);
                    lower.add(i, j, -strength);
                }
            });
            for (variable, observation) in self.sites.beginning_at(pixel) {
                let weight = self.sites.carriers[observation].weight;
                let own = place(variable);
                lower.add(own, own, weight);
                let taps = &self.sites.seen.taps[observation];
                for (k, (one, share)) in taps.iter().enumerate() {
                    lower.add(own, place(one), -weight * share);
                    for (other, across) in taps.iter().skip(k) {
                        lower.add(place(one), place(other), weight * share * across);
                    }
                }
            }
        }
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
        for (j, &variable) in points.iter().enumerate() {
            let Some(point) = self.sites.carried(variable) else {
                continue;
            };
            let (weight, at) = (self.sites.carriers[point].weight, place(variable));
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
            ..
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
