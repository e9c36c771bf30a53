//! The elimination of a tile: a small rectangle of pixels whose shape alone decides every step, so that eight
//! tiles of a shape are eliminated at once, one in each lane of a vector.
//!
//! Within a tile the order is that of nested dissection again. Its pixels are numbered in the order of
//! elimination, and those around it, its ring, after them.

use super::runs::{Run, runs};
use super::stencil::{Entry, Neighbours};
use lsdc_kernels::cholesky::{Eight, factorise_eight};
use lsdc_kernels::simd::Level;

/// Regions of at most this many pixels are not cut further.
const LEAF: usize = 9;

/// Kept variables are padded to multiples of this.
const PAD: usize = 4;

/// The elimination of a line or leaf of a tile.
#[derive(Debug)]
pub(super) struct PivotStep {
    /// The first variable that it eliminates.
    pub(super) first: usize,
    /// How many it eliminates.
    pub(super) count: usize,
    /// Later variables that these depend on, in order.
    pub(super) kept: Vec<u32>,
    /// Rows of the factor: those eliminated, then `kept`, padded.
    pub(super) rows: usize,
    /// Where its columns begin in the factor of the tile.
    pub(super) start: usize,
    /// The steps of the halves, and where the variables go that they keep.
    pub(super) halves: Vec<(usize, Vec<Run>)>,
    /// Row, column, and index among the sources.
    pub(super) entries: Vec<[u32; 3]>,
    /// Memory that the halves need.
    room: usize,
}

impl PivotStep {
    fn padded(&self) -> usize {
        self.rows - self.count
    }

    /// The values of its rest.
    fn square(&self) -> usize {
        self.padded() * self.padded()
    }
}

/// An entry of the matrix that a tile reads: its kind, and the offset of its pixel from the tile's first.
#[derive(Clone, Copy, Debug)]
pub(super) struct Source {
    pub(super) entry: Entry,
    pub(super) x: i32,
    pub(super) y: i32,
}

/// How tiles of a shape are eliminated.
#[derive(Debug)]
pub(super) struct SymbolicFactor {
    /// The pixels of the tile in the order of elimination, (x, y) from its first.
    pub(super) order: Vec<(usize, usize)>,
    /// The offsets of the pixels of the ring.
    pub(super) ring: Vec<(i32, i32)>,
    pub(super) steps: Vec<PivotStep>,
    pub(super) sources: Vec<Source>,
    /// Values of the factor.
    pub(super) length: usize,
}

/// A rectangle of the tile.
#[derive(Clone, Copy)]
struct Part {
    x: usize,
    y: usize,
    width: usize,
    height: usize,
}

impl Part {
    /// Two halves, and the line of pixels between them, unless it is a leaf.
    fn cut(self) -> Option<([Self; 2], Self)> {
        let length = self.width.max(self.height);
        if self.width * self.height <= LEAF || length < 3 {
            return None;
        }
        let along = |first: usize, length: usize| {
            if self.width >= self.height {
                Self {
                    x: self.x + first,
                    width: length,
                    ..self
                }
            } else {
                Self {
                    y: self.y + first,
                    height: length,
                    ..self
                }
            }
        };
        let half = length / 2;
        let halves = [along(0, half), along(half + 1, length - half - 1)];
        Some((halves, along(half, 1)))
    }
}

impl SymbolicFactor {
    pub(super) fn new(width: usize, height: usize, neighbours: Neighbours) -> Self {
        let mut program = Self {
            order: Vec::with_capacity(width * height),
            ring: ring(width as i32, height as i32, neighbours),
            steps: Vec::new(),
            sources: Vec::new(),
            length: 0,
        };
        let whole = Part {
            x: 0,
            y: 0,
            width,
            height,
        };
        program.cut(whole);
        program.link(width, height, neighbours);
        program
    }

    /// Orders the pixels of a part, and returns its step.
    fn cut(&mut self, part: Part) -> usize {
        let (halves, own) = match part.cut() {
            Some((halves, line)) => (Some(halves), line),
            None => (None, part),
        };
        let halves = halves.map(|halves| halves.map(|half| (self.cut(half), Vec::new())));
        let first = self.order.len();
        for y in own.y..own.y + own.height {
            self.order
                .extend((own.x..own.x + own.width).map(|x| (x, y)));
        }
        self.steps.push(PivotStep {
            first,
            count: own.width * own.height,
            kept: Vec::new(),
            rows: 0,
            start: 0,
            halves: halves.into_iter().flatten().collect(),
            entries: Vec::new(),
            room: 0,
        });
        self.steps.len() - 1
    }

    /// Finds what each step keeps, reads and takes from its halves.
    fn link(&mut self, width: usize, height: usize, neighbours: Neighbours) {
        let across = width as i32 + 2;
        let index = |x: i32, y: i32| ((y + 1) * across + x + 1) as usize;
        let mut numbers = vec![u32::MAX; across as usize * (height + 2)];
        let order = self.order.iter().map(|&(x, y)| (x as i32, y as i32));
        for (number, (x, y)) in order.chain(self.ring.iter().copied()).enumerate() {
            numbers[index(x, y)] = number as u32;
        }
        let mut sources = vec![[u32::MAX; 5]; numbers.len()];
        for s in 0..self.steps.len() {
            let (done, rest) = self.steps.split_at_mut(s);
            let step = &mut rest[0];
            let end = (step.first + step.count) as u32;
            let mut kept: Vec<u32> = step
                .halves
                .iter()
                .flat_map(|&(half, _)| &done[half].kept)
                .copied()
                .collect();
            let own = step.first..step.first + step.count;
            let mut joins = Vec::new();
            for (column, &(x, y)) in self.order[own].iter().enumerate() {
                let (x, y) = (x as i32, y as i32);
                joins.push((step.first as u32 + column as u32, column, x, y, Entry::Own));
                for &([dx, dy], entry, [ex, ey]) in neighbours.list() {
                    let number = numbers[index(x + dx, y + dy)];
                    if number as usize > step.first + column {
                        joins.push((number, column, x + ex, y + ey, entry));
                        kept.push(number);
                    }
                }
            }
            kept.retain(|&number| number >= end);
            kept.sort_unstable();
            kept.dedup();
            let row = |number: u32| {
                if number < end {
                    return number - step.first as u32;
                }
                let place = kept.partition_point(|&other| other < number);
                (step.count + place) as u32
            };
            for (number, column, x, y, entry) in joins {
                let source = &mut sources[index(x, y)][entry as usize];
                if *source == u32::MAX {
                    *source = self.sources.len() as u32;
                    self.sources.push(Source { entry, x, y });
                }
                step.entries.push([row(number), column as u32, *source]);
            }
            let mut room = 0;
            for (half, own) in step.halves.iter_mut().rev() {
                let half = &done[*half];
                let rows = half.kept.iter().map(|&number| Some(row(number)));
                *own = runs(rows, step.count);
                room = half.square() + half.room.max(room);
            }
            step.room = room;
            step.rows = step.count + kept.len().next_multiple_of(PAD);
            step.start = self.length;
            step.kept = kept;
            self.length += step.rows * step.count;
        }
    }

    /// The last step, which keeps the ring.
    pub(super) fn last(&self) -> &PivotStep {
        &self.steps[self.steps.len() - 1]
    }

    /// Values of the rest, `[padded ring, padded ring]`.
    pub(super) fn rest(&self) -> usize {
        self.last().square()
    }

    /// The rests of eight tiles one after the other, `[ring, ring]` each, of which lower halves are set.
    #[inline(always)]
    pub(super) fn part(&self, rest: &[Eight], parts: &mut [f64]) {
        let (ring, stride) = (self.ring.len(), self.last().padded());
        for j in 0..ring {
            let column = &rest[j * stride..][..ring];
            for (i, value) in column.iter().enumerate().skip(j) {
                for (lane, value) in value.iter().enumerate() {
                    parts[(lane * ring + j) * ring + i] = *value;
                }
            }
        }
    }

    /// Values that [`Self::eliminate`] needs beside factor and rest.
    pub(super) fn room(&self) -> usize {
        self.last().room
    }

    /// Eliminates eight tiles, whose entries are in the order of the sources.
    pub(super) fn eliminate(
        &self,
        level: Level,
        entries: &[Eight],
        factor: &mut [Eight],
        rest: &mut [Eight],
        room: &mut [Eight],
    ) -> bool {
        self.step(self.steps.len() - 1, level, entries, factor, rest, room)
    }

    fn step(
        &self,
        at: usize,
        level: Level,
        entries: &[Eight],
        factor: &mut [Eight],
        rest: &mut [Eight],
        room: &mut [Eight],
    ) -> bool {
        let step = &self.steps[at];
        let mut rests: [&mut [Eight]; 2] = [&mut [], &mut []];
        let mut room = room;
        for ((half, _), part) in step.halves.iter().zip(&mut rests) {
            let (own, left) = room.split_at_mut(self.steps[*half].square());
            if !self.step(*half, level, entries, factor, own, left) {
                return false;
            }
            (*part, room) = (own, left);
        }
        let panel = &mut factor[step.start..][..step.rows * step.count];
        level.vectorised(
            #[inline(always)]
            || step.assemble(entries, panel, rest, &self.steps, &rests),
        );
        factorise_eight(level, panel, step.count, rest)
    }
}

impl PivotStep {
    #[inline(always)]
    fn assemble(
        &self,
        entries: &[Eight],
        panel: &mut [Eight],
        rest: &mut [Eight],
        steps: &[Self],
        rests: &[&mut [Eight]; 2],
    ) {
        let padded = self.padded();
        panel.fill([0.0; 8]);
        for (j, column) in rest.chunks_exact_mut(padded.max(1)).enumerate() {
            column[j..].fill([0.0; 8]);
        }
        for &[row, column, source] in &self.entries {
            panel[column as usize * self.rows + row as usize] = entries[source as usize];
        }
        for ((half, runs), values) in self.halves.iter().zip(rests) {
            let stride = steps[*half].padded();
            for (r, run) in runs.iter().enumerate() {
                for (j, to) in run.from.clone().zip(run.to..) {
                    let (target, first) = match to.checked_sub(self.count) {
                        None => (&mut panel[to * self.rows..][..self.rows], 0),
                        Some(kept) => (&mut rest[kept * padded..][..padded], self.count),
                    };
                    // Both are in the order of elimination.
                    add(
                        &mut target[to - first..],
                        &values[j * stride..][j..run.from.end],
                    );
                    for later in &runs[r + 1..] {
                        let values = &values[j * stride..][later.from.clone()];
                        add(&mut target[later.to - first..], values);
                    }
                }
            }
        }
    }
}

#[inline(always)]
fn add(target: &mut [Eight], values: &[Eight]) {
    for (target, value) in target.iter_mut().zip(values) {
        target.iter_mut().zip(value).for_each(|(t, v)| *t += v);
    }
}

/// The pixels around a rectangle, side by side, with the corners if they are neighbours.
fn ring(width: i32, height: i32, neighbours: Neighbours) -> Vec<(i32, i32)> {
    let sides = [-1, width].into_iter();
    let ends = [-1, height].into_iter();
    let sides = sides.flat_map(|x| (0..height).map(move |y| (x, y)));
    let ends = ends.flat_map(|y| (0..width).map(move |x| (x, y)));
    let corners = [(-1, -1), (width, -1), (-1, height), (width, height)];
    let corners = corners
        .into_iter()
        .filter(|_| neighbours == Neighbours::Eight);
    sides.chain(ends).chain(corners).collect()
}
