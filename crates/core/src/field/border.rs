//! Observations bordering a factor: `W = L^-1 S'` for the matrix S whose rows interpolate the field at the observations, and
//! the covariances `S K^-1 S' = W' W` of the field there.
//!
//! An observation affects the variables of its own tile and of the separators around it, up to the last: these rows of W are
//! dense, all others 0. Observations are sorted by the first eliminated pixel among those that they interpolate, so that the
//! observations of a separator and all below it are consecutive. They are processed in strips of rows, one task each.

use super::factor::{Factor, both};
use super::plan::{Child, FORK, PixelLocation, TileBatch};
use super::strip::{STRIP, Strip, dot};
use super::sweep::Rows;
use crate::bilinear::InterpolationWeights;
use lsdc_kernels::cholesky::{PAD, solve_rows, subtract_product};
use lsdc_kernels::schedule::InTasks;
use rayon::prelude::*;
use std::collections::HashMap;
use std::ops::Range;

/// Columns of a covariance per task: part of a strip, because the first columns have many more rows than the last.
const TOGETHER: usize = STRIP / 4;

/// `W`, by the variables of separators and tiles.
#[derive(Debug)]
pub(super) struct Border {
    /// The observation at each position.
    pub(super) order: Vec<usize>,
    /// Rows of each separator, in strips.
    separators: Vec<Vec<Strip>>,
    /// Rows of the tiles with observations.
    tiles: Vec<TileRows>,
}

/// The rows of `W'` of the observations of a tile.
#[derive(Debug)]
struct TileRows {
    tile: usize,
    positions: Range<usize>,
    /// `[observations, pixels in the order of elimination]`, row by row.
    values: Vec<f64>,
    /// Their update of the ring, in the same layout.
    ring: Vec<f64>,
}

impl Border {
    pub(super) fn new(factor: &Factor, interpolation: &[InterpolationWeights]) -> Self {
        let plan = &*factor.plan;
        let first = |interpolation: &InterpolationWeights| {
            interpolation
                .iter()
                .map(|(pixel, _)| plan.turn(pixel))
                .min()
        };
        let mut order: Vec<usize> = (0..interpolation.len()).collect();
        let turns: Vec<_> = interpolation
            .iter()
            .map(|interpolation| first(interpolation).unwrap_or_default())
            .collect();
        order.sort_by_key(|&i| (turns[i], i));
        let turns: Vec<u32> = order.iter().map(|&i| turns[i].0).collect();

        let mut on_tiles: Vec<Vec<(usize, usize, f64)>> = vec![Vec::new(); plan.tiles.len()];
        let mut on_separators: HashMap<usize, Vec<(usize, usize, f64)>> = HashMap::new();
        for (position, &i) in order.iter().enumerate() {
            for (pixel, share) in interpolation[i].iter() {
                match plan.locations[pixel as usize] {
                    PixelLocation::Tile(tile, at) => {
                        on_tiles[tile as usize].push((position, at as usize, share));
                    }
                    PixelLocation::Separator(separator, at) => {
                        let list = on_separators.entry(separator as usize).or_default();
                        list.push((position, at as usize, share));
                    }
                }
            }
        }
        let tiles = tile_rows(factor, &on_tiles, &turns);
        let mut separators: Vec<Vec<Strip>> = Vec::new();
        separators.resize_with(plan.separators.len(), Vec::new);
        if let Child::Separator(root) = plan.root {
            let mut of_tiles = vec![None; plan.tiles.len()];
            for rows in &tiles {
                of_tiles[rows.tile] = Some(rows);
            }
            let ancestors = Ancestors {
                factor,
                of_tiles,
                on_separators,
                turns: &turns,
            };
            ancestors.separator(root, &mut separators, 0);
        }
        Self {
            order,
            separators,
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
            for strips in &self.separators {
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
        // The observations of a tile are consecutive, and belong to no other tile.
        let mut remaining = &mut all[..];
        let mut done = 0;
        let mut tiles = Vec::with_capacity(self.tiles.len());
        let mut in_order: Vec<&TileRows> = self.tiles.iter().collect();
        in_order.sort_by_key(|rows| rows.positions.start);
        for rows in in_order {
            let (_, later) = remaining.split_at_mut((rows.positions.start - done) * size);
            let (own, later) = later.split_at_mut(rows.positions.len() * size);
            (remaining, done) = (later, rows.positions.end);
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
        for (rights, lefts) in self.separators.iter().zip(&other.separators) {
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
        let of_line = |(separator, strips): (usize, &Vec<Strip>)| {
            let own = &plan.separators[separator].own;
            let mut sums = vec![0.0; if strips.is_empty() { 0 } else { own.len() }];
            for strip in strips {
                strip.add_products(x, &mut sums);
            }
            sums
        };
        let separators: Vec<_> = self.separators.par_iter().enumerate().gather(of_line);
        for (separator, sums) in plan.separators.iter().zip(&separators) {
            for (&pixel, sum) in separator.own.iter().zip(sums) {
                values[pixel as usize] += sum;
            }
        }
        let of_tile = |rows: &TileRows| {
            let pixels = plan.symbolic(rows.tile).order.len();
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
            let (tile, symbolic) = (&plan.tiles[rows.tile], plan.symbolic(rows.tile));
            for (&(u, v), sum) in symbolic.order.iter().zip(sums) {
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
            for (separator, strips) in plan.separators.iter().zip(&self.separators) {
                let Some(strip) = strips.iter().find(|s| s.first / STRIP == i) else {
                    continue;
                };
                let columns = strip.values.chunks_exact(strip.rows);
                for (&pixel, column) in separator.own.iter().zip(columns) {
                    let value = values[pixel as usize];
                    let found = found[strip.first % STRIP..].iter_mut().zip(column);
                    found.for_each(|(sum, factor)| *sum += factor * value);
                }
            }
        });
        for rows in &self.tiles {
            let (tile, symbolic) = (&plan.tiles[rows.tile], plan.symbolic(rows.tile));
            let lists = rows.values.chunks_exact(symbolic.order.len());
            for (position, list) in rows.positions.clone().zip(lists) {
                let pairs = symbolic.order.iter().zip(list);
                let products = pairs.map(|(&(u, v), value)| {
                    value * values[(tile.top + v) * plan.width + tile.left + u]
                });
                found[position] += products.sum::<f64>();
            }
        }
        found
    }
}

/// Returns the positions of the observations whose first eliminated pixel is in a child; `turns` are those of all positions.
fn positions(factor: &Factor, turns: &[u32], child: Child) -> Range<usize> {
    let own = factor.plan.turns(child);
    let at = |turn: u32| turns.partition_point(|other| *other < turn);
    at(own.start)..at(own.end)
}

/// Forward substitution through the separators.
struct Ancestors<'a> {
    factor: &'a Factor,
    of_tiles: Vec<Option<&'a TileRows>>,
    /// Interpolation weights of observations at the pixels of each separator: position, column and share.
    on_separators: HashMap<usize, Vec<(usize, usize, f64)>>,
    turns: &'a [u32],
}

impl Ancestors<'_> {
    /// Fills in the strips of a separator and of all separators below it, which begin at `base` in `separators`, and returns
    /// the update of the boundary of the separator.
    fn separator(&self, at: usize, separators: &mut [Vec<Strip>], base: usize) -> Vec<Strip> {
        let separator = &self.factor.plan.separators[at];
        let positions = positions(self.factor, self.turns, Child::Separator(at));
        if positions.is_empty() {
            return Vec::new();
        }
        let (below, own) = separators.split_at_mut(at - base);
        let mut front = RowsOfFront {
            count: separator.own.len(),
            own: Strip::all(&positions, separator.own.len()),
            update: Strip::all(&positions, separator.padded()),
        };
        for &(position, column, share) in self.on_separators.get(&at).into_iter().flatten() {
            front.add(column as u32, position, &[share]);
        }
        let left = if let [Child::Separator(one), Child::Separator(two)] = separator.children {
            let middle = one + 1;
            let (first, second) = below.split_at_mut(middle - base);
            let (one, two) = both(
                separator.tiles > FORK,
                || self.separator(one, first, base),
                || self.separator(two, second, middle),
            );
            [one, two]
        } else {
            separator.children.map(|child| match child {
                Child::Separator(child) => self.separator(child, below, base),
                Child::Tile(_) => Vec::new(),
            })
        };
        for ((child, places), left) in separator
            .children
            .into_iter()
            .zip(&separator.places)
            .zip(left)
        {
            for strip in left {
                let columns = strip.values.chunks_exact(strip.rows);
                for (values, place) in columns.zip(places) {
                    if let Some(place) = place {
                        front.add(*place, strip.first, values);
                    }
                }
            }
            if let Child::Tile(tile) = child
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
        let panel = self.factor.columns(separator);
        let pairs = front.own.par_iter_mut().zip(&mut front.update);
        pairs.each(|(own, update)| {
            let (own, update) = (&mut own.values, &mut update.values);
            solve_rows(self.factor.level, panel, separator.own.len(), own, update);
        });
        own[0] = front.own;
        front.update
    }
}

/// The rows of observations in the front of a separator.
struct RowsOfFront {
    /// Number of eliminated columns.
    count: usize,
    own: Vec<Strip>,
    /// Strips for the columns of the boundary.
    update: Vec<Strip>,
}

impl RowsOfFront {
    /// Adds values of a column at consecutive positions of one strip.
    fn add(&mut self, place: u32, position: usize, values: &[f64]) {
        let (strips, column) = match (place as usize).checked_sub(self.count) {
            None => (&mut self.own, place as usize),
            Some(place) => (&mut self.update, place),
        };
        let strip = position / STRIP - strips[0].first / STRIP;
        let strip = &mut strips[strip];
        let start = column * strip.rows + position - strip.first;
        let target = strip.values[start..][..values.len()].iter_mut();
        target.zip(values).for_each(|(sum, value)| *sum += value);
    }
}

/// Substitutes forward through the tiles that contain observations.
fn tile_rows(
    factor: &Factor,
    on_tiles: &[Vec<(usize, usize, f64)>],
    turns: &[u32],
) -> Vec<TileRows> {
    let plan = &*factor.plan;
    let of_batch = |batch: &TileBatch| {
        let symbolic = &plan.symbolic_factors[batch.symbolic];
        let pixels = symbolic.order.len();
        let mut found: Vec<TileRows> = batch
            .tiles
            .iter()
            .map(|&tile| {
                let positions = positions(factor, turns, Child::Tile(tile));
                TileRows {
                    tile,
                    values: vec![0.0; positions.len() * pixels],
                    ring: vec![0.0; positions.len() * symbolic.ring.len()],
                    positions,
                }
            })
            .collect();
        let most = found.iter().map(|rows| rows.positions.len()).max();
        let columns = &factor.tiles[batch.factor..][..symbolic.length];
        let mut x: Vec<Rows<1>> = vec![[[0.0]; 8]; pixels + symbolic.ring.len()];
        for round in 0..most.unwrap_or(0) {
            x.fill([[0.0]; 8]);
            for (lane, rows) in found.iter().enumerate() {
                let own = on_tiles[rows.tile].iter();
                let own = own.filter(|(position, ..)| *position == rows.positions.start + round);
                own.for_each(|&(_, at, share)| x[at][lane][0] += share);
            }
            factor.level.vectorised(
                #[inline(always)]
                || symbolic.forward(columns, &mut x),
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
