//! The Cholesky factor of a field's equations, in the order of a plan.

use super::plan::{FORK, Half, Line, Plan};
use super::runs::{Left, assemble};
use super::stencil::Stencil;
use lsdc_kernels::cholesky::{Eight, factorise};
use lsdc_kernels::simd::Level;
use rayon::prelude::*;
use std::sync::{Arc, Mutex, PoisonError};

/// A factor.
#[derive(Debug)]
pub(super) struct Factor {
    pub(super) plan: Arc<Plan>,
    pub(super) level: Level,
    /// Of all tiles, eight at a time.
    pub(super) tiles: Vec<Eight>,
    /// Of all lines.
    pub(super) lines: Vec<f64>,
}

/// What is left of tiles and lines until the next line is eliminated.
#[derive(Debug, Default)]
struct Rests {
    tiles: Vec<f64>,
    lines: Vec<f64>,
}

/// Memory that factors of a plan use one after the other, because new memory costs as much time as a good part
/// of the factor.
#[derive(Debug, Default)]
pub(super) struct Pool {
    factors: Mutex<Vec<(Vec<Eight>, Vec<f64>)>>,
    rests: Mutex<Vec<Rests>>,
}

/// How many unused factors are kept, and how many bytes each may have: what is larger is given back.
const SPARE: usize = 2;
const MOST_BYTES: usize = 1 << 27;

fn take<T: Default>(list: &Mutex<Vec<T>>) -> T {
    let mut list = list.lock().unwrap_or_else(PoisonError::into_inner);
    list.pop().unwrap_or_default()
}

fn give<T>(list: &Mutex<Vec<T>>, value: T, bytes: usize) {
    if bytes > MOST_BYTES {
        return;
    }
    let mut list = list.lock().unwrap_or_else(PoisonError::into_inner);
    if list.len() < SPARE {
        list.push(value);
    }
}

impl Drop for Factor {
    fn drop(&mut self) {
        let memory = (
            std::mem::take(&mut self.tiles),
            std::mem::take(&mut self.lines),
        );
        let bytes = size_of_val(&memory.0[..]) + size_of_val(&memory.1[..]);
        give(&self.plan.pool.factors, memory, bytes);
    }
}

impl Factor {
    /// Factorises a matrix; `None` if it is not positive definite.
    pub(super) fn new(plan: Arc<Plan>, stencil: &Stencil) -> Option<Self> {
        let (mut tiles, mut lines) = take(&plan.pool.factors);
        let mut rests = take(&plan.pool.rests);
        let level = Level::here();
        let room = match plan.root {
            Half::Tile(_) => 0,
            Half::Line(root) => plan.lines[root].room + plan.lines[root].square(),
        };
        tiles.resize(plan.lengths.tiles, [0.0; 8]);
        lines.resize(plan.lengths.lines, 0.0);
        rests.tiles.resize(plan.lengths.rests, 0.0);
        rests.lines.resize(room, 0.0);
        let mut found = eliminate_tiles(&plan, level, stencil, &mut tiles, &mut rests.tiles);
        if let (true, Half::Line(root)) = (found, plan.root) {
            let work = Lines {
                plan: &plan,
                level,
                stencil,
                rests: &rests.tiles,
            };
            let (rest, room) = rests.lines.split_at_mut(plan.lines[root].square());
            found = work.eliminate(root, &mut lines, 0, rest, room);
        }
        let bytes = size_of_val(&rests.tiles[..]) + size_of_val(&rests.lines[..]);
        give(&plan.pool.rests, rests, bytes);
        let factor = Self {
            plan,
            level,
            tiles,
            lines,
        };
        found.then_some(factor)
    }

    /// The columns of a line, `[rows, own]`.
    pub(super) fn columns(&self, line: &Line) -> &[f64] {
        &self.lines[line.start..][..line.rows * line.own.len()]
    }
}

fn eliminate_tiles(
    plan: &Plan,
    level: Level,
    stencil: &Stencil,
    factors: &mut [Eight],
    rests: &mut [f64],
) -> bool {
    let (mut factors, mut rests) = (factors, rests);
    let mut work = Vec::with_capacity(plan.batches.len());
    for batch in &plan.batches {
        let program = &plan.programs[batch.program];
        let (factor, others) = factors.split_at_mut(program.length);
        let (rest, left) = rests.split_at_mut(8 * program.ring.len().pow(2));
        (factors, rests) = (others, left);
        work.push((batch, program, factor, rest));
    }
    let memory = || (Vec::new(), Vec::new(), Vec::new());
    let work = work.into_par_iter();
    work.map_init(
        memory,
        |(entries, room, eight), (batch, program, factor, rest)| {
            entries.resize(program.sources.len(), [0.0; 8]);
            room.resize(program.room(), [0.0; 8]);
            eight.resize(program.rest(), [0.0; 8]);
            // Lanes without a tile do as the last one does.
            let tile = |lane: usize| &plan.tiles[batch.tiles[lane.min(batch.tiles.len() - 1)]];
            let places: [usize; 8] = std::array::from_fn(|lane| {
                let tile = tile(lane);
                stencil.place(tile.left, tile.top)
            });
            for (value, source) in entries.iter_mut().zip(&program.sources) {
                let offset = stencil.offset(source.x, source.y);
                let map = stencil.map(source.entry);
                *value = places.map(|place| map[place.wrapping_add_signed(offset)]);
            }
            let found = program.eliminate(level, entries, factor, eight, room);
            let ranks = std::array::from_fn(|lane| &tile(lane).ranks[..]);
            level.vectorised(
                #[inline(always)]
                || program.part(eight, ranks, rest),
            );
            found
        },
    )
    .all(|found| found)
}

/// The elimination of lines.
struct Lines<'a> {
    plan: &'a Plan,
    level: Level,
    stencil: &'a Stencil,
    rests: &'a [f64],
}

impl Lines<'_> {
    /// Eliminates a line and all below it; `factor` holds the columns of these from `base` on.
    fn eliminate(
        &self,
        at: usize,
        factor: &mut [f64],
        base: usize,
        rest: &mut [f64],
        room: &mut [f64],
    ) -> bool {
        let line = &self.plan.lines[at];
        let (below, panel) = factor.split_at_mut(line.start - base);
        let panel = &mut panel[..line.rows * line.own.len()];
        let lines = &self.plan.lines;
        let halves = line.halves.map(|half| match half {
            Half::Line(half) => Some(half),
            Half::Tile(_) => None,
        });
        let mut found = true;
        let mut left: [&[f64]; 2] = [&[], &[]];
        if let [Some(one), Some(two)] = halves {
            let split = lines[one].start + lines[one].rows * lines[one].own.len() - base;
            let (first, second) = below.split_at_mut(split);
            let (rest_one, room) = room.split_at_mut(lines[one].square());
            let rest_two;
            if line.tiles > FORK {
                let (room_one, room) = room.split_at_mut(lines[one].room);
                let (rest, room) = room.split_at_mut(lines[two].square());
                let (one, two) = rayon::join(
                    || self.eliminate(one, first, base, rest_one, room_one),
                    || self.eliminate(two, second, base + split, rest, room),
                );
                (found, rest_two) = (one && two, rest);
            } else {
                found &= self.eliminate(one, first, base, rest_one, room);
                let (rest, room) = room.split_at_mut(lines[two].square());
                found &= self.eliminate(two, second, base + split, rest, room);
                rest_two = rest;
            }
            left = [rest_one, rest_two];
        } else {
            let mut room = room;
            for (half, left) in line.halves.into_iter().zip(&mut left) {
                match half {
                    Half::Line(half) => {
                        let (own, others) = room.split_at_mut(lines[half].square());
                        found &= self.eliminate(half, below, base, own, others);
                        (*left, room) = (own, others);
                    }
                    Half::Tile(tile) => *left = self.rest(tile),
                }
            }
        }
        if !found {
            return false;
        }
        let halves = [0, 1].map(|i| Left {
            runs: &line.ascending[i],
            values: left[i],
            stride: match line.halves[i] {
                Half::Line(half) => lines[half].padded(),
                Half::Tile(tile) => self.plan.program(tile).ring.len(),
            },
        });
        self.level.vectorised(
            #[inline(always)]
            || assemble((panel, rest), [line.rows, line.own.len()], &halves),
        );
        for &(row, column, entry, place) in &line.entries {
            let value = self.stencil.get(entry, place as usize);
            panel[column as usize * line.rows + row as usize] += value;
        }
        factorise(self.level, panel, line.own.len(), rest)
    }

    /// What a tile leaves.
    fn rest(&self, tile: usize) -> &[f64] {
        let tile = &self.plan.tiles[tile];
        let batch = &self.plan.batches[tile.batch];
        let ring = self.plan.programs[batch.program].ring.len();
        &self.rests[batch.rest + tile.lane * ring * ring..][..ring * ring]
    }
}

/// Both results, at the same time if it pays.
pub(super) fn both<A: Send, B: Send>(
    parallel: bool,
    one: impl FnOnce() -> A + Send,
    two: impl FnOnce() -> B + Send,
) -> (A, B) {
    if parallel {
        rayon::join(one, two)
    } else {
        (one(), two())
    }
}
