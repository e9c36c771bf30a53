//! The Cholesky factor of a field's equations, in the order of a plan.

use super::plan::{Child, FORK, Plan, Separator, TileBatch};
use super::runs::IndexRun;
use super::stencil::Stencil;
use super::symbolic::SymbolicFactor;
use lsdc_kernels::cholesky::{F64x8, factorise};
use lsdc_kernels::schedule::{join, region};
use lsdc_kernels::simd::Level;
use rayon::prelude::*;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A Cholesky factor.
#[derive(Debug)]
pub(super) struct Factor {
    pub(super) plan: Arc<Plan>,
    pub(super) level: Level,
    /// Columns of all tiles, eight at a time.
    pub(super) tiles: Vec<F64x8>,
    /// Columns of all separators.
    pub(super) separators: Vec<f64>,
}

/// Buffers for values of tiles and of separators: of a factor, or of update matrices.
#[derive(Debug)]
struct Memory<T> {
    tiles: Vec<T>,
    separators: Vec<f64>,
}

/// A pool of buffers for factors of any plan, because allocation takes a considerable part of the time of a factorisation.
struct BufferPool<T>(Mutex<Vec<Memory<T>>>);

static FACTORS: BufferPool<F64x8> = BufferPool(Mutex::new(Vec::new()));
static UPDATES: BufferPool<f64> = BufferPool(Mutex::new(Vec::new()));

/// Frees the buffers of update matrices, before other matrices of this size are needed.
pub(super) fn free_updates() {
    UPDATES.list().clear();
}

/// Frees all buffers for further factors.
pub(super) fn free_memory() {
    FACTORS.list().clear();
    free_updates();
}

impl<T: Copy> BufferPool<T> {
    fn list(&self) -> MutexGuard<'_, Vec<Memory<T>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns a buffer of these lengths with arbitrary values, from the pool if it has one: the smallest sufficient one, or
    /// the largest.
    fn take(&self, (tiles, zero): (usize, T), separators: usize) -> Memory<T> {
        let mut memory = {
            let mut list = self.list();
            list.sort_unstable_by_key(Memory::bytes);
            let suffices = |own: &Memory<T>| {
                own.tiles.capacity() >= tiles && own.separators.capacity() >= separators
            };
            let place = list.iter().position(suffices);
            let place = place.or(list.len().checked_sub(1));
            place.map(|place| list.remove(place))
        }
        .unwrap_or_default();
        resize(&mut memory.tiles, tiles, zero);
        resize(&mut memory.separators, separators, 0.0);
        memory
    }

    fn give(&self, memory: Memory<T>) {
        /// Number of buffers in the pool, and their largest size in bytes: larger ones are freed.
        const KEPT: usize = 4;
        const MOST_BYTES: usize = 1 << 27;
        let mut list = self.list();
        if list.len() < KEPT && memory.bytes() <= MOST_BYTES {
            list.push(memory);
        }
    }
}

/// Resizes memory with arbitrary values. A buffer that is too short is freed before a new one is allocated.
fn resize<T: Copy>(memory: &mut Vec<T>, length: usize, value: T) {
    if memory.capacity() < length {
        *memory = Vec::new();
    }
    memory.resize(length, value);
}

impl<T> Memory<T> {
    fn bytes(&self) -> usize {
        size_of::<T>() * self.tiles.capacity() + size_of::<f64>() * self.separators.capacity()
    }
}

impl<T> Default for Memory<T> {
    fn default() -> Self {
        Self {
            tiles: Vec::new(),
            separators: Vec::new(),
        }
    }
}

impl Drop for Factor {
    fn drop(&mut self) {
        FACTORS.give(Memory {
            tiles: std::mem::take(&mut self.tiles),
            separators: std::mem::take(&mut self.separators),
        });
    }
}

impl Factor {
    /// Factorises a matrix; `None` if it is not positive definite.
    pub(super) fn new(plan: Arc<Plan>, stencil: &Stencil) -> Option<Self> {
        let factor = FACTORS.take((plan.lengths.tiles, [0.0; 8]), plan.lengths.separators);
        let Memory {
            mut tiles,
            mut separators,
        } = factor;
        let level = Level::here();
        let workspace = match plan.root {
            Child::Tile(_) => 0,
            Child::Separator(root) => {
                plan.separators[root].workspace + plan.separators[root].square()
            }
        };
        let mut updates = UPDATES.take((plan.lengths.updates, 0.0), workspace);
        let mut found = eliminate_tiles(&plan, level, stencil, &mut tiles, &mut updates.tiles);
        if let (true, Child::Separator(root)) = (found, plan.root) {
            let work = SeparatorElimination {
                plan: &plan,
                level,
                stencil,
                updates: &updates.tiles,
            };
            let (update, workspace) = updates
                .separators
                .split_at_mut(plan.separators[root].square());
            found = work.eliminate(root, &mut separators, 0, update, workspace);
        }
        UPDATES.give(updates);
        let factor = Self {
            plan,
            level,
            tiles,
            separators,
        };
        found.then_some(factor)
    }

    /// The columns of a separator, `[rows, own]`.
    pub(super) fn columns(&self, separator: &Separator) -> &[f64] {
        &self.separators[separator.start..][..separator.rows * separator.own.len()]
    }
}

/// A batch of tiles, its symbolic factor, and the memory for its factor and update matrices.
type BatchWork<'a> = (
    &'a TileBatch,
    &'a SymbolicFactor,
    &'a mut [F64x8],
    &'a mut [f64],
);

/// Memory of a thread, reused for successive batches.
type Memories = (Vec<F64x8>, Vec<F64x8>, Vec<F64x8>);

fn eliminate_tiles(
    plan: &Plan,
    level: Level,
    stencil: &Stencil,
    factors: &mut [F64x8],
    updates: &mut [f64],
) -> bool {
    let (mut factors, mut updates) = (factors, updates);
    let mut work = Vec::with_capacity(plan.batches.len());
    for batch in &plan.batches {
        let symbolic = &plan.symbolic_factors[batch.symbolic];
        let (factor, others) = factors.split_at_mut(symbolic.length);
        let (update, left) = updates.split_at_mut(8 * symbolic.ring.len().pow(2));
        (factors, updates) = (others, left);
        work.push((batch, symbolic, factor, update));
    }
    let memory = || (Vec::new(), Vec::new(), Vec::new());
    let eliminate = |(entries, workspace, eight): &mut Memories,
                     (batch, symbolic, factor, update): BatchWork<'_>| {
        entries.resize(symbolic.sources.len(), [0.0; 8]);
        workspace.resize(symbolic.workspace(), [0.0; 8]);
        eight.resize(symbolic.update(), [0.0; 8]);
        // Lanes without a tile repeat the last tile.
        let tile = |lane: usize| &plan.tiles[batch.tiles[lane.min(batch.tiles.len() - 1)]];
        let places: [usize; 8] = std::array::from_fn(|lane| {
            let tile = tile(lane);
            stencil.place(tile.left, tile.top)
        });
        for (value, source) in entries.iter_mut().zip(&symbolic.sources) {
            let offset = stencil.offset(source.x, source.y);
            let map = stencil.map(source.entry);
            *value = places.map(|place| map[place.wrapping_add_signed(offset)]);
        }
        let found = symbolic.eliminate(symbolic.last(), level, entries, factor, eight, workspace);
        level.vectorised(
            #[inline(always)]
            || symbolic.part(eight, update),
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

/// The elimination of separators.
struct SeparatorElimination<'a> {
    plan: &'a Plan,
    level: Level,
    stencil: &'a Stencil,
    updates: &'a [f64],
}

impl SeparatorElimination<'_> {
    /// Eliminates a separator and all separators below it; their columns begin at `base` in `factor`.
    fn eliminate(
        &self,
        at: usize,
        factor: &mut [f64],
        base: usize,
        update: &mut [f64],
        workspace: &mut [f64],
    ) -> bool {
        let separator = &self.plan.separators[at];
        let (below, panel) = factor.split_at_mut(separator.start - base);
        let front = &mut Front {
            count: separator.own.len(),
            panel: &mut panel[..separator.rows * separator.own.len()],
            rows: separator.rows,
            update,
        };
        front.clear();
        for &(row, column, entry, place) in &separator.entries {
            let value = self.stencil.get(entry, place as usize);
            front.column(column as usize, row as usize)[0] = value;
        }
        let separators = &self.plan.separators;
        let children = separator.children.map(|child| match child {
            Child::Separator(child) => Some(child),
            Child::Tile(_) => None,
        });
        let found = if let [Some(one), Some(two)] = children {
            let split =
                separators[one].start + separators[one].rows * separators[one].own.len() - base;
            let (first, second) = below.split_at_mut(split);
            let (rest_one, workspace) = workspace.split_at_mut(separators[one].square());
            let (found, rest_two) = if separator.tiles > FORK {
                let (room_one, workspace) = workspace.split_at_mut(separators[one].workspace);
                let (rest_two, workspace) = workspace.split_at_mut(separators[two].square());
                let (one, two) = join(
                    || self.eliminate(one, first, base, rest_one, room_one),
                    || self.eliminate(two, second, base + split, rest_two, workspace),
                );
                (one && two, rest_two)
            } else {
                let found = self.eliminate(one, first, base, rest_one, workspace);
                let (rest_two, workspace) = workspace.split_at_mut(separators[two].square());
                let two = self.eliminate(two, second, base + split, rest_two, workspace);
                (found && two, rest_two)
            };
            self.add(separator, 0, one, rest_one, front);
            self.add(separator, 1, two, rest_two, front);
            found
        } else {
            let mut found = true;
            for (i, child) in separator.children.into_iter().enumerate() {
                match child {
                    Child::Separator(child) => {
                        let (own, workspace) = workspace.split_at_mut(separators[child].square());
                        found &= self.eliminate(child, below, base, own, workspace);
                        self.add(separator, i, child, own, front);
                    }
                    Child::Tile(tile) => self.add_tile(separator, i, tile, front),
                }
            }
            found
        };
        found && factorise(self.level, front.panel, front.count, front.update)
    }

    /// Adds the update matrix of a separator to the front of the next.
    fn add(
        &self,
        separator: &Separator,
        child: usize,
        from: usize,
        values: &[f64],
        front: &mut Front<'_>,
    ) {
        let stride = self.plan.separators[from].padded();
        self.level.vectorised(
            #[inline(always)]
            || front.add(&separator.runs[child], values, stride),
        );
    }

    /// Adds the update matrix of a tile.
    fn add_tile(&self, separator: &Separator, child: usize, tile: usize, front: &mut Front<'_>) {
        let tile = &self.plan.tiles[tile];
        let batch = &self.plan.batches[tile.batch];
        let ring = self.plan.symbolic_factors[batch.symbolic].ring.len();
        let values = &self.updates[batch.update + tile.lane * ring * ring..][..ring * ring];
        self.level.vectorised(
            #[inline(always)]
            || front.add(&separator.runs[child], values, ring),
        );
    }
}

/// The equations of a separator, lower half.
struct Front<'a> {
    /// Number of eliminated variables.
    count: usize,
    /// Columns of the eliminated variables, `[rows, count]`.
    panel: &'a mut [f64],
    rows: usize,
    /// The update matrix of the boundary, `[boundary, boundary]`.
    update: &'a mut [f64],
}

impl Front<'_> {
    /// Returns a column, starting at a row.
    #[inline(always)]
    fn column(&mut self, column: usize, row: usize) -> &mut [f64] {
        let boundary = self.rows - self.count;
        match column.checked_sub(self.count) {
            None => &mut self.panel[column * self.rows + row..][..self.rows - row],
            Some(own) => &mut self.update[own * boundary + row - self.count..][..self.rows - row],
        }
    }

    fn clear(&mut self) {
        self.panel.fill(0.0);
        let boundary = self.rows - self.count;
        for (j, column) in self.update.chunks_exact_mut(boundary.max(1)).enumerate() {
            column[j..].fill(0.0);
        }
    }

    /// Adds the lower half of a matrix whose variables are in runs of this one's.
    #[inline(always)]
    fn add(&mut self, runs: &[IndexRun], values: &[f64], stride: usize) {
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

/// Returns both results; computed in parallel if `parallel` is set.
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
