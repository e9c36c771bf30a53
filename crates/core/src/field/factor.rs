//! The Cholesky factor of a field's equations, in the order of a plan.

use super::plan::{Batch, FORK, Half, Line, Plan};
use super::runs::Run;
use super::stencil::Stencil;
use super::symbolic::SymbolicFactor;
use lsdc_kernels::cholesky::{Eight, factorise};
use lsdc_kernels::schedule::{join, region};
use lsdc_kernels::simd::Level;
use rayon::prelude::*;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

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

/// Memory for values of tiles and of lines: of a factor, or of what they leave until the next line is eliminated.
#[derive(Debug)]
struct Memory<T> {
    tiles: Vec<T>,
    lines: Vec<f64>,
}

/// Memory that factors of any plan use one after the other, because new memory costs as much time as a good part of a
/// factor.
struct BufferPool<T>(Mutex<Vec<Memory<T>>>);

static FACTORS: BufferPool<Eight> = BufferPool(Mutex::new(Vec::new()));
static RESTS: BufferPool<f64> = BufferPool(Mutex::new(Vec::new()));

/// Gives the memory that is kept for what tiles and lines leave back: for what is needed after a factor and is as large.
pub(super) fn forget_rests() {
    RESTS.list().clear();
}

/// Gives all memory back that is kept for further factors.
pub(super) fn forget_memory() {
    FACTORS.list().clear();
    forget_rests();
}

impl<T: Copy> BufferPool<T> {
    fn list(&self) -> MutexGuard<'_, Vec<Memory<T>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Any values of these lengths, in memory that was used before, if there is any: the smallest that suffices, or the
    /// largest.
    fn take(&self, (tiles, zero): (usize, T), lines: usize) -> Memory<T> {
        let mut memory = {
            let mut list = self.list();
            list.sort_unstable_by_key(Memory::bytes);
            let suffices =
                |own: &Memory<T>| own.tiles.capacity() >= tiles && own.lines.capacity() >= lines;
            let place = list.iter().position(suffices);
            let place = place.or(list.len().checked_sub(1));
            place.map(|place| list.remove(place))
        }
        .unwrap_or_default();
        resize(&mut memory.tiles, tiles, zero);
        resize(&mut memory.lines, lines, 0.0);
        memory
    }

    fn give(&self, memory: Memory<T>) {
        /// How many are kept, and how many bytes each may have: what is larger is given back.
        const KEPT: usize = 4;
        const MOST_BYTES: usize = 1 << 27;
        let mut list = self.list();
        if list.len() < KEPT && memory.bytes() <= MOST_BYTES {
            list.push(memory);
        }
    }
}

/// Makes memory of any values as long as needed. What is too short is given back first.
fn resize<T: Copy>(memory: &mut Vec<T>, length: usize, value: T) {
    if memory.capacity() < length {
        *memory = Vec::new();
    }
    memory.resize(length, value);
}

impl<T> Memory<T> {
    fn bytes(&self) -> usize {
        size_of::<T>() * self.tiles.capacity() + size_of::<f64>() * self.lines.capacity()
    }
}

impl<T> Default for Memory<T> {
    fn default() -> Self {
        Self {
            tiles: Vec::new(),
            lines: Vec::new(),
        }
    }
}

impl Drop for Factor {
    fn drop(&mut self) {
        FACTORS.give(Memory {
            tiles: std::mem::take(&mut self.tiles),
            lines: std::mem::take(&mut self.lines),
        });
    }
}

impl Factor {
    /// Factorises a matrix; `None` if it is not positive definite.
    pub(super) fn new(plan: Arc<Plan>, stencil: &Stencil) -> Option<Self> {
        let factor = FACTORS.take((plan.lengths.tiles, [0.0; 8]), plan.lengths.lines);
        let Memory {
            mut tiles,
            mut lines,
        } = factor;
        let level = Level::here();
        let room = match plan.root {
            Half::Tile(_) => 0,
            Half::Line(root) => plan.lines[root].room + plan.lines[root].square(),
        };
        let mut rests = RESTS.take((plan.lengths.rests, 0.0), room);
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
        RESTS.give(rests);
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

/// A batch of tiles, its program, and where its factor and what it leaves go.
type Work<'a> = (
    &'a Batch,
    &'a SymbolicFactor,
    &'a mut [Eight],
    &'a mut [f64],
);

/// Memory of a thread for one batch after the other.
type Memories = (Vec<Eight>, Vec<Eight>, Vec<Eight>);

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
    let eliminate = |(entries, room, eight): &mut Memories,
                     (batch, program, factor, rest): Work<'_>| {
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
        level.vectorised(
            #[inline(always)]
            || program.part(eight, rest),
        );
        found
    };
    region(|region| {
        let work = work.into_par_iter();
        work.map_init(memory, |memory, work| {
            region.task(|| eliminate(memory, work))
        })
        .all(|found| found)
    })
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
        let front = &mut Front {
            count: line.own.len(),
            panel: &mut panel[..line.rows * line.own.len()],
            rows: line.rows,
            rest,
        };
        front.clear();
        for &(row, column, entry, place) in &line.entries {
            let value = self.stencil.get(entry, place as usize);
            front.column(column as usize, row as usize)[0] = value;
        }
        let lines = &self.plan.lines;
        let halves = line.halves.map(|half| match half {
            Half::Line(half) => Some(half),
            Half::Tile(_) => None,
        });
        let found = if let [Some(one), Some(two)] = halves {
            let split = lines[one].start + lines[one].rows * lines[one].own.len() - base;
            let (first, second) = below.split_at_mut(split);
            let (rest_one, room) = room.split_at_mut(lines[one].square());
            let (found, rest_two) = if line.tiles > FORK {
                let (room_one, room) = room.split_at_mut(lines[one].room);
                let (rest_two, room) = room.split_at_mut(lines[two].square());
                let (one, two) = join(
                    || self.eliminate(one, first, base, rest_one, room_one),
                    || self.eliminate(two, second, base + split, rest_two, room),
                );
                (one && two, rest_two)
            } else {
                let found = self.eliminate(one, first, base, rest_one, room);
                let (rest_two, room) = room.split_at_mut(lines[two].square());
                let two = self.eliminate(two, second, base + split, rest_two, room);
                (found && two, rest_two)
            };
            self.add(line, 0, one, rest_one, front);
            self.add(line, 1, two, rest_two, front);
            found
        } else {
            let mut found = true;
            for (i, half) in line.halves.into_iter().enumerate() {
                match half {
                    Half::Line(half) => {
                        let (own, room) = room.split_at_mut(lines[half].square());
                        found &= self.eliminate(half, below, base, own, room);
                        self.add(line, i, half, own, front);
                    }
                    Half::Tile(tile) => self.add_tile(line, i, tile, front),
                }
            }
            found
        };
        found && factorise(self.level, front.panel, front.count, front.rest)
    }

    /// Adds what a line leaves to the equations of the next.
    fn add(&self, line: &Line, half: usize, from: usize, values: &[f64], front: &mut Front<'_>) {
        let stride = self.plan.lines[from].padded();
        self.level.vectorised(
            #[inline(always)]
            || front.add(&line.runs[half], values, stride),
        );
    }

    /// Adds what a tile leaves.
    fn add_tile(&self, line: &Line, half: usize, tile: usize, front: &mut Front<'_>) {
        let tile = &self.plan.tiles[tile];
        let batch = &self.plan.batches[tile.batch];
        let ring = self.plan.programs[batch.program].ring.len();
        let values = &self.rests[batch.rest + tile.lane * ring * ring..][..ring * ring];
        self.level.vectorised(
            #[inline(always)]
            || front.add(&line.runs[half], values, ring),
        );
    }
}

/// The equations of a line, lower half.
struct Front<'a> {
    /// Variables that are eliminated.
    count: usize,
    /// Their columns, `[rows, count]`.
    panel: &'a mut [f64],
    rows: usize,
    /// Those of the variables that are kept, `[kept, kept]`.
    rest: &'a mut [f64],
}

impl Front<'_> {
    /// A column from a row on.
    #[inline(always)]
    fn column(&mut self, column: usize, row: usize) -> &mut [f64] {
        let kept = self.rows - self.count;
        match column.checked_sub(self.count) {
            None => &mut self.panel[column * self.rows + row..][..self.rows - row],
            Some(own) => &mut self.rest[own * kept + row - self.count..][..self.rows - row],
        }
    }

    fn clear(&mut self) {
        self.panel.fill(0.0);
        let kept = self.rows - self.count;
        for (j, column) in self.rest.chunks_exact_mut(kept.max(1)).enumerate() {
            column[j..].fill(0.0);
        }
    }

    /// Adds the lower half of a matrix whose variables are in runs of this one's.
    #[inline(always)]
    fn add(&mut self, runs: &[Run], values: &[f64], stride: usize) {
        for (r, run) in runs.iter().enumerate() {
            for (j, to) in run.from.clone().zip(run.to..) {
                let below = &values[j * stride + j..j * stride + run.from.end];
                let target = self.column(to, to).iter_mut();
                target.zip(below).for_each(|(t, v)| *t += v);
            }
            for other in &runs[r + 1..] {
                if other.to > run.to {
                    for (j, to) in run.from.clone().zip(run.to..) {
                        let values = &values[j * stride..][other.from.clone()];
                        let target = self.column(to, other.to).iter_mut();
                        target.zip(values).for_each(|(t, v)| *t += v);
                    }
                } else {
                    for (i, to) in other.from.clone().zip(other.to..) {
                        let values = values[run.from.start * stride + i..].iter();
                        let values = values.step_by(stride).take(run.from.len());
                        let target = self.column(to, run.to).iter_mut();
                        target.zip(values).for_each(|(t, v)| *t += v);
                    }
                }
            }
        }
    }
}

/// Both results, at the same time if it pays.
pub(super) fn both<A: Send, B: Send>(
    parallel: bool,
    one: impl FnOnce() -> A + Send,
    two: impl FnOnce() -> B + Send,
) -> (A, B) {
    if parallel {
        join(one, two)
    } else {
        (one(), two())
    }
}
