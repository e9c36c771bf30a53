//! Observations beside a factor: `W = L^-1 S'` for the matrix S whose rows interpolate the field at them, and the
//! covariances `S K^-1 S' = W' W` of the field there.
//!
//! An observation concerns the variables of its own tile and of the lines around it, up to the last: these
//! rows of W are dense, all others 0. Observations are put in the order in which the pixels that they
//! interpolate are eliminated first, so that those of a line and all below it are consecutive. They are worked
//! on in strips of rows, each of which is a task of its own.

use super::factor::{Factor, both};
use super::plan::{Batch, FORK, Half, Home};
use super::strip::{STRIP, Strip, dot};
use super::sweep::Rows;
use crate::bilinear::InterpolationWeights;
use lsdc_kernels::cholesky::{PAD, solve_rows, subtract_product};
use lsdc_kernels::schedule::InTasks;
use rayon::prelude::*;
use std::collections::HashMap;
use std::ops::Range;

/// Columns of a covariance that a task finds: part of a strip, because the first columns have many more rows than the last.
const TOGETHER: usize = STRIP / 4;

/// `W`, by the variables of lines and tiles.
#[derive(Debug)]
pub(super) struct Border {
    /// The observation at each position.
    pub(super) order: Vec<usize>,
    /// Of each line, by strips.
    lines: Vec<Vec<Strip>>,
    /// Of the tiles with observations.
    tiles: Vec<TileRows>,
}

/// The rows of `W'` of the observations of a tile.
#[derive(Debug)]
struct TileRows {
    tile: usize,
    positions: Range<usize>,
    /// `[observations, pixels in the order of elimination]`, row by row.
    values: Vec<f64>,
    /// What is left of them for the ring, likewise.
    ring: Vec<f64>,
}

impl Border {
    pub(super) fn new(factor: &Factor, taps: &[InterpolationWeights]) -> Self {
        let plan = &*factor.plan;
        let first =
            |taps: &InterpolationWeights| taps.iter().map(|(pixel, _)| plan.turn(pixel)).min();
        let mut order: Vec<usize> = (0..taps.len()).collect();
        let turns: Vec<_> = taps
            .iter()
            .map(|taps| first(taps).unwrap_or_default())
            .collect();
        order.sort_by_key(|&i| (turns[i], i));
        let turns: Vec<u32> = order.iter().map(|&i| turns[i].0).collect();

        let mut on_tiles: Vec<Vec<(usize, usize, f64)>> = vec![Vec::new(); plan.tiles.len()];
        let mut on_lines: HashMap<usize, Vec<(usize, usize, f64)>> = HashMap::new();
        for (position, &i) in order.iter().enumerate() {
            for (pixel, share) in taps[i].iter() {
                match plan.homes[pixel as usize] {
                    Home::Tile(tile, at) => {
                        on_tiles[tile as usize].push((position, at as usize, share));
                    }
                    Home::Line(line, at) => {
                        let list = on_lines.entry(line as usize).or_default();
                        list.push((position, at as usize, share));
                    }
                }
            }
        }
        let tiles = tile_rows(factor, &on_tiles, &turns);
        let mut lines: Vec<Vec<Strip>> = Vec::new();
        lines.resize_with(plan.lines.len(), Vec::new);
        if let Half::Line(root) = plan.root {
            let mut of_tiles = vec![None; plan.tiles.len()];
            for rows in &tiles {
                of_tiles[rows.tile] = Some(rows);
            }
            let ancestors = Ancestors {
                factor,
                of_tiles,
                on_lines,
                turns: &turns,
            };
            ancestors.line(root, &mut lines, 0);
        }
        Self {
            order,
            lines,
            tiles,
        }
    }

    /// `W' W`, lower half, column by column, at positions padded to a multiple of [`PAD`].
    pub(super) fn covariance(&self, factor: &Factor) -> Vec<f64> {
        let size = self.order.len().next_multiple_of(PAD);
        let mut all = vec![0.0; size * size];
        let columns = all.par_chunks_mut(TOGETHER * size).enumerate();
        // One by one, because the first columns are the longest.
        columns.with_max_len(1).each(|(i, columns)| {
            let own = i * TOGETHER..i * TOGETHER + columns.len() / size;
            for strips in &self.lines {
                let holds = |s: &Strip| s.first < own.end && own.start < s.first + s.rows;
                let Some(at) = strips.iter().position(holds) else {
                    continue;
                };
                let right = &strips[at];
                let depth = right.values.len() / right.rows;
                let first = own.start.max(right.first);
                let count = own.end.min(right.first + right.rows) - first;
                let block = right.block().below(first - right.first);
                for left in &strips[at..] {
                    let start = (first - own.start) * size + left.first;
                    subtract_product(
                        factor.level,
                        (&mut columns[start..], size),
                        [left.rows, count, depth],
                        left.block(),
                        block,
                    );
                }
            }
            for value in columns {
                *value = -*value;
            }
        });
        // The observations of a tile are consecutive, and of no other tile.
        let mut rest = &mut all[..];
        let mut done = 0;
        let mut tiles = Vec::with_capacity(self.tiles.len());
        let mut in_order: Vec<&TileRows> = self.tiles.iter().collect();
        in_order.sort_by_key(|rows| rows.positions.start);
        for rows in in_order {
            let (_, later) = rest.split_at_mut((rows.positions.start - done) * size);
            let (own, later) = later.split_at_mut(rows.positions.len() * size);
            (rest, done) = (later, rows.positions.end);
            tiles.push((rows, own));
        }
        tiles.into_par_iter().each(|(rows, columns)| {
            let pixels = rows.values.len() / rows.positions.len().max(1);
            let lists: Vec<&[f64]> = rows.values.chunks_exact(pixels).collect();
            for (k, (column, one)) in columns.chunks_exact_mut(size).zip(&lists).enumerate() {
                let sums = column[rows.positions.clone()].iter_mut().zip(&lists);
                for (sum, other) in sums.skip(k) {
                    let products = one.iter().zip(*other).map(|(a, b)| a * b);
                    *sum += products.sum::<f64>();
                }
            }
        });
        all
    }

    /// Minus `V' W`, where V are the rows of another border of the same factor, at the positions of a strip of that
    /// border: `[STRIP, own positions]`, padded.
    pub(super) fn across(&self, factor: &Factor, other: &Self, strip: usize) -> Vec<f64> {
        let mut all = vec![0.0; STRIP * self.order.len().next_multiple_of(PAD)];
        for (rights, lefts) in self.lines.iter().zip(&other.lines) {
            let Some(left) = lefts.iter().find(|s| s.first / STRIP == strip) else {
                continue;
            };
            let depth = left.values.len() / left.rows;
            for right in rights {
                let start = right.first * STRIP + left.first % STRIP;
                subtract_product(
                    factor.level,
                    (&mut all[start..], STRIP),
                    [left.rows, right.rows, depth],
                    left.block(),
                    right.block(),
                );
            }
        }
        let mut of_tiles: HashMap<usize, &TileRows> = HashMap::new();
        of_tiles.extend(self.tiles.iter().map(|rows| (rows.tile, rows)));
        for left in &other.tiles {
            let Some(right) = of_tiles.get(&left.tile) else {
                continue;
            };
            let pixels = left.values.len() / left.positions.len().max(1);
            let lists = left.positions.clone().zip(left.values.chunks_exact(pixels));
            for (i, one) in lists.filter(|(i, _)| i / STRIP == strip) {
                let lists = right.values.chunks_exact(pixels);
                for (j, two) in right.positions.clone().zip(lists) {
                    all[j * STRIP + i % STRIP] -= dot(one, two);
                }
            }
        }
        all
    }

    /// Adds `W x` to values in the order of pixels.
    pub(super) fn add_to(&self, factor: &Factor, x: &[f64], values: &mut [f64]) {
        let plan = &*factor.plan;
        let of_line = |(line, strips): (usize, &Vec<Strip>)| {
            let own = &plan.lines[line].own;
            let mut sums = vec![0.0; if strips.is_empty() { 0 } else { own.len() }];
            for strip in strips {
                strip.add_products(x, &mut sums);
            }
            sums
        };
        let lines: Vec<_> = self.lines.par_iter().enumerate().gather(of_line);
        for (line, sums) in plan.lines.iter().zip(&lines) {
            for (&pixel, sum) in line.own.iter().zip(sums) {
                values[pixel as usize] += sum;
            }
        }
        let of_tile = |rows: &TileRows| {
            let pixels = plan.program(rows.tile).order.len();
            let mut sums = vec![0.0; pixels];
            for (x, list) in x[rows.positions.clone()]
                .iter()
                .zip(rows.values.chunks_exact(pixels))
            {
                sums.iter_mut()
                    .zip(list)
                    .for_each(|(sum, value)| *sum += x * value);
            }
            sums
        };
        let tiles: Vec<_> = self.tiles.par_iter().gather(of_tile);
        for (rows, sums) in self.tiles.iter().zip(&tiles) {
            let (tile, program) = (&plan.tiles[rows.tile], plan.program(rows.tile));
            for (&(u, v), sum) in program.order.iter().zip(sums) {
                values[(tile.top + v) * plan.width + tile.left + u] += sum;
            }
        }
    }

    /// `W' values`.
    pub(super) fn products(&self, factor: &Factor, values: &[f64]) -> Vec<f64> {
        let plan = &*factor.plan;
        let mut found = vec![0.0; self.order.len()];
        let parts = found.par_chunks_mut(STRIP).enumerate();
        parts.each(|(i, found)| {
            for (line, strips) in plan.lines.iter().zip(&self.lines) {
                let Some(strip) = strips.iter().find(|s| s.first / STRIP == i) else {
                    continue;
                };
                let columns = strip.values.chunks_exact(strip.rows);
                for (&pixel, column) in line.own.iter().zip(columns) {
                    let value = values[pixel as usize];
                    let found = found[strip.first % STRIP..].iter_mut().zip(column);
                    found.for_each(|(sum, factor)| *sum += factor * value);
                }
            }
        });
        for rows in &self.tiles {
            let (tile, program) = (&plan.tiles[rows.tile], plan.program(rows.tile));
            let lists = rows.values.chunks_exact(program.order.len());
            for (position, list) in rows.positions.clone().zip(lists) {
                let pairs = program.order.iter().zip(list);
                let products = pairs.map(|(&(u, v), value)| {
                    value * values[(tile.top + v) * plan.width + tile.left + u]
                });
                found[position] += products.sum::<f64>();
            }
        }
        found
    }
}

/// The positions of the observations that concern a half first; `turns` are those of all positions.
fn positions(factor: &Factor, turns: &[u32], half: Half) -> Range<usize> {
    let own = factor.plan.turns(half);
    let at = |turn: u32| turns.partition_point(|other| *other < turn);
    at(own.start)..at(own.end)
}

/// Forward substitution through the lines.
struct Ancestors<'a> {
    factor: &'a Factor,
    of_tiles: Vec<Option<&'a TileRows>>,
    /// Position, column and share of what observations take from each line.
    on_lines: HashMap<usize, Vec<(usize, usize, f64)>>,
    turns: &'a [u32],
}

impl Ancestors<'_> {
    /// Fills in the strips of a line and all below it, which are in `lines` from `base` on, and returns what is
    /// left for the variables that the line keeps.
    fn line(&self, at: usize, lines: &mut [Vec<Strip>], base: usize) -> Vec<Strip> {
        let line = &self.factor.plan.lines[at];
        let positions = positions(self.factor, self.turns, Half::Line(at));
        if positions.is_empty() {
            return Vec::new();
        }
        let (below, own) = lines.split_at_mut(at - base);
        let mut front = RowsOfFront {
            count: line.own.len(),
            own: Strip::all(&positions, line.own.len()),
            rest: Strip::all(&positions, line.padded()),
        };
        for &(position, column, share) in self.on_lines.get(&at).into_iter().flatten() {
            front.add(column as u32, position, &[share]);
        }
        let left = if let [Half::Line(one), Half::Line(two)] = line.halves {
            let middle = one + 1;
            let (first, second) = below.split_at_mut(middle - base);
            let (one, two) = both(
                line.tiles > FORK,
                || self.line(one, first, base),
                || self.line(two, second, middle),
            );
            [one, two]
        } else {
            line.halves.map(|half| match half {
                Half::Line(half) => self.line(half, below, base),
                Half::Tile(_) => Vec::new(),
            })
        };
        for ((half, places), left) in line.halves.into_iter().zip(&line.places).zip(left) {
            for strip in left {
                let columns = strip.values.chunks_exact(strip.rows);
                for (values, place) in columns.zip(places) {
                    if let Some(place) = place {
                        front.add(*place, strip.first, values);
                    }
                }
            }
            if let Half::Tile(tile) = half
                && let Some(rows) = self.of_tiles[tile]
            {
                let lists = rows.ring.chunks_exact(places.len());
                for (position, values) in rows.positions.clone().zip(lists) {
                    for (value, place) in values.iter().zip(places) {
                        if let Some(place) = place {
                            front.add(*place, position, &[*value]);
                        }
                    }
                }
            }
        }
        let panel = self.factor.columns(line);
        let pairs = front.own.par_iter_mut().zip(&mut front.rest);
        pairs.each(|(own, rest)| {
            let (own, rest) = (&mut own.values, &mut rest.values);
            solve_rows(self.factor.level, panel, line.own.len(), own, rest);
        });
        own[0] = front.own;
        front.rest
    }
}

/// The rows of observations in the front of a line.
struct RowsOfFront {
    /// Columns that are eliminated.
    count: usize,
    own: Vec<Strip>,
    /// For the columns that are kept.
    rest: Vec<Strip>,
}

impl RowsOfFront {
    /// Adds values of a column at consecutive positions of one strip.
    fn add(&mut self, place: u32, position: usize, values: &[f64]) {
        let (strips, column) = match (place as usize).checked_sub(self.count) {
            None => (&mut self.own, place as usize),
            Some(place) => (&mut self.rest, place),
        };
        let strip = position / STRIP - strips[0].first / STRIP;
        let strip = &mut strips[strip];
        let start = column * strip.rows + position - strip.first;
        let target = strip.values[start..][..values.len()].iter_mut();
        target.zip(values).for_each(|(sum, value)| *sum += value);
    }
}

/// Substitutes forward through the tiles that observations lie in.
fn tile_rows(
    factor: &Factor,
    on_tiles: &[Vec<(usize, usize, f64)>],
    turns: &[u32],
) -> Vec<TileRows> {
    let plan = &*factor.plan;
    let of_batch = |batch: &Batch| {
        let program = &plan.programs[batch.program];
        let pixels = program.order.len();
        let mut found: Vec<TileRows> = batch
            .tiles
            .iter()
            .map(|&tile| {
                let positions = positions(factor, turns, Half::Tile(tile));
                TileRows {
                    tile,
                    values: vec![0.0; positions.len() * pixels],
                    ring: vec![0.0; positions.len() * program.ring.len()],
                    positions,
                }
            })
            .collect();
        let most = found.iter().map(|rows| rows.positions.len()).max();
        let columns = &factor.tiles[batch.factor..][..program.length];
        let mut x: Vec<Rows<1>> = vec![[[0.0]; 8]; pixels + program.ring.len()];
        for round in 0..most.unwrap_or(0) {
            x.fill([[0.0]; 8]);
            for (lane, rows) in found.iter().enumerate() {
                let own = on_tiles[rows.tile].iter();
                let own = own.filter(|(position, ..)| *position == rows.positions.start + round);
                own.for_each(|&(_, at, share)| x[at][lane][0] += share);
            }
            factor.level.vectorised(
                #[inline(always)]
                || program.forward(columns, &mut x),
            );
            for (lane, rows) in found.iter_mut().enumerate() {
                if round < rows.positions.len() {
                    let (own, ring) = x.split_at(pixels);
                    let at = |list: &[Rows<1>], target: &mut [f64]| {
                        let target = target.iter_mut().zip(list);
                        target.for_each(|(target, value)| [*target] = value[lane]);
                    };
                    at(own, &mut rows.values[round * pixels..][..pixels]);
                    let count = ring.len();
                    at(ring, &mut rows.ring[round * count..][..count]);
                }
            }
        }
        found.retain(|rows| !rows.positions.is_empty());
        found
    };
    let found: Vec<_> = plan.batches.par_iter().gather(of_batch);
    found.into_iter().flatten().collect()
}
