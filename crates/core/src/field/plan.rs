//! The order in which the pixels of a grid are eliminated, and where every number goes: all that depends on the
//! size of the grid, and on which pixels are joined, alone.
//!
//! Lines one pixel wide cut the grid into tiles. The tiles are eliminated first, then the lines between them, in
//! the order of nested dissection (George 1973): the line that separates two halves after both.

use super::runs::{Run, runs};
use super::stencil::{Entry, Neighbours, padded};
use super::symbolic::SymbolicFactor;
use lsdc_kernels::cholesky::PAD;
use std::collections::HashMap;
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// About the length of a tile's side: of 7 to 23 the fastest, by a little.
const SIDE: usize = 15;

/// Halves of more tiles than this are eliminated in parallel.
pub(super) const FORK: usize = 8;

/// A rectangle between lines.
#[derive(Debug)]
pub(super) struct Tile {
    pub(super) left: usize,
    pub(super) top: usize,
    /// Its place among eight in a batch.
    pub(super) batch: usize,
    pub(super) lane: usize,
    /// When it is eliminated, among tiles and lines.
    pub(super) turn: u32,
}

/// Up to eight tiles of a shape.
#[derive(Debug)]
pub(super) struct Batch {
    pub(super) program: usize,
    pub(super) tiles: Vec<usize>,
    /// Where it begins in the factors and the rests of all tiles.
    pub(super) factor: usize,
    pub(super) rest: usize,
}

/// What a line separates.
#[derive(Clone, Copy, Debug)]
pub(super) enum Half {
    Tile(usize),
    Line(usize),
}

/// The elimination of a line.
#[derive(Debug)]
pub(super) struct Line {
    /// Its pixels.
    pub(super) own: Vec<u32>,
    /// The pixels that depend on these, in the order of their elimination.
    pub(super) kept: Vec<u32>,
    /// Rows of the factor: own, then kept, padded.
    pub(super) rows: usize,
    /// Where its columns begin in the factor of all lines.
    pub(super) start: usize,
    /// Where its pixels begin among those of all lines.
    pub(super) first: usize,
    pub(super) halves: [Half; 2],
    /// Where the variables go that each half keeps, or `None` in a tile's ring where no pixel is.
    pub(super) places: [Vec<Option<u32>>; 2],
    /// The same, as runs.
    pub(super) runs: [Vec<Run>; 2],
    /// Row, column, kind and place of each entry of the matrix.
    pub(super) entries: Vec<(u32, u32, Entry, u32)>,
    /// Memory that the halves need.
    pub(super) room: usize,
    /// Tiles in both halves.
    pub(super) tiles: usize,
    /// The turns of its halves and its own.
    pub(super) turns: Range<u32>,
}

impl Line {
    /// Kept variables, padded.
    pub(super) fn padded(&self) -> usize {
        self.rows - self.own.len()
    }

    /// The values of its rest.
    pub(super) fn square(&self) -> usize {
        self.padded() * self.padded()
    }
}

/// Where a pixel is eliminated: in a tile, at a place in the order of its program, or in a line.
#[derive(Clone, Copy, Debug)]
pub(super) enum Home {
    Tile(u32, u32),
    Line(u32, u32),
}

/// How many values there are.
#[derive(Debug, Default)]
pub(super) struct Lengths {
    /// Of the factors of tiles, eight at a time.
    pub(super) tiles: usize,
    /// Of what tiles leave.
    pub(super) rests: usize,
    /// Of the factors of lines.
    pub(super) lines: usize,
    /// Pixels of lines.
    pixels: usize,
}

/// The elimination of grids of a size.
#[derive(Debug)]
pub(crate) struct Plan {
    pub(super) height: usize,
    pub(super) width: usize,
    neighbours: Neighbours,
    pub(super) programs: Vec<SymbolicFactor>,
    pub(super) tiles: Vec<Tile>,
    pub(super) batches: Vec<Batch>,
    /// Halves come before their line.
    pub(super) lines: Vec<Line>,
    pub(super) homes: Vec<Home>,
    /// The whole grid.
    pub(super) root: Half,
    pub(super) lengths: Lengths,
}

/// A span of tiles along an axis: where each begins, and its length.
type Spans = Vec<[usize; 2]>;

/// Cuts a length into spans of about `SIDE`, with one pixel between them.
fn spans(length: usize) -> Spans {
    let count = ((length + 1) as f64 / (SIDE + 1) as f64).round().max(1.0) as usize;
    let total = length + 1 - count;
    let mut start = 0;
    (0..count)
        .map(|i| {
            let own = total * (i + 1) / count - total * i / count;
            start += own + 1;
            [start - own - 1, own]
        })
        .collect()
}

/// What is known while the grid is cut.
struct Cutter {
    plan: Plan,
    across: Spans,
    down: Spans,
    turn: u32,
}

/// The plans of the last few sizes.
static PLANS: Mutex<Vec<Arc<Plan>>> = Mutex::new(Vec::new());

fn plans() -> MutexGuard<'static, Vec<Arc<Plan>>> {
    PLANS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Gives the memory of plans back that no field uses.
pub(super) fn forget_plans() {
    plans().clear();
}

impl Plan {
    /// The plan of a size, made once for the last few sizes.
    pub(super) fn of(height: usize, width: usize, neighbours: Neighbours) -> Arc<Self> {
        /// How many plans are kept.
        const KEPT: usize = 4;
        let key = (height, width, neighbours);
        let same = |plan: &Arc<Self>| (plan.height, plan.width, plan.neighbours) == key;
        let kept = {
            let mut plans = plans();
            plans.iter().position(same).map(|at| plans.remove(at))
        };
        let plan = kept.unwrap_or_else(|| Arc::new(Self::new(height, width, neighbours)));
        let mut plans = plans();
        if !plans.iter().any(same) {
            plans.insert(0, plan.clone());
            plans.truncate(KEPT);
        }
        plan
    }

    pub(super) fn new(height: usize, width: usize, neighbours: Neighbours) -> Self {
        let (across, down) = (spans(width), spans(height));
        let mut shapes = HashMap::new();
        let mut programs = Vec::new();
        let mut tiles = Vec::new();
        let mut members: Vec<Vec<usize>> = Vec::new();
        for &[top, height] in &down {
            for &[left, width] in &across {
                let program = *shapes.entry((width, height)).or_insert_with(|| {
                    programs.push(SymbolicFactor::new(width, height, neighbours));
                    members.push(Vec::new());
                    programs.len() - 1
                });
                members[program].push(tiles.len());
                tiles.push(Tile {
                    left,
                    top,
                    batch: 0,
                    lane: 0,
                    turn: 0,
                });
            }
        }
        let mut batches: Vec<Batch> = Vec::new();
        let mut lengths = Lengths::default();
        for (program, members) in members.into_iter().enumerate() {
            for eight in members.chunks(8) {
                for (lane, &tile) in eight.iter().enumerate() {
                    tiles[tile].batch = batches.len();
                    tiles[tile].lane = lane;
                }
                batches.push(Batch {
                    program,
                    tiles: eight.to_vec(),
                    factor: lengths.tiles,
                    rest: lengths.rests,
                });
                lengths.tiles += programs[program].length;
                lengths.rests += 8 * programs[program].ring.len().pow(2);
            }
        }
        let mut homes = vec![Home::Line(0, 0); height * width];
        for (t, tile) in tiles.iter().enumerate() {
            let program: &SymbolicFactor = &programs[batches[tile.batch].program];
            for (i, &(x, y)) in program.order.iter().enumerate() {
                homes[(tile.top + y) * width + tile.left + x] = Home::Tile(t as u32, i as u32);
            }
        }
        let (i, j) = (0..across.len(), 0..down.len());
        let mut cutter = Cutter {
            plan: Self {
                height,
                width,
                neighbours,
                programs,
                tiles,
                batches,
                lines: Vec::new(),
                homes,
                root: Half::Tile(0),
                lengths,
            },
            across,
            down,
            turn: 0,
        };
        cutter.plan.root = cutter.cut(i, j);
        for line in 0..cutter.plan.lines.len() {
            cutter.link(line);
        }
        cutter.plan
    }

    /// The number of pixels.
    pub(super) fn len(&self) -> usize {
        self.homes.len()
    }

    pub(super) fn program(&self, tile: usize) -> &SymbolicFactor {
        &self.programs[self.batches[self.tiles[tile].batch].program]
    }

    /// The pixels around a tile, in the order of its ring.
    pub(super) fn ring(&self, tile: usize) -> impl Iterator<Item = Option<u32>> {
        let Tile { left, top, .. } = self.tiles[tile];
        let ring = self.program(tile).ring.iter();
        ring.map(move |&(x, y)| {
            let (x, y) = (left as i64 + i64::from(x), top as i64 + i64::from(y));
            let inside =
                (0..self.width as i64).contains(&x) && (0..self.height as i64).contains(&y);
            inside.then(|| (y * self.width as i64 + x) as u32)
        })
    }

    /// When a pixel's tile or line is eliminated, and its place there.
    pub(super) fn turn(&self, pixel: u32) -> (u32, u32) {
        match self.homes[pixel as usize] {
            Home::Tile(tile, at) => (self.tiles[tile as usize].turn, at),
            Home::Line(line, at) => (self.lines[line as usize].turns.end - 1, at),
        }
    }

    /// The turns of a half.
    pub(super) fn turns(&self, half: Half) -> Range<u32> {
        match half {
            Half::Tile(tile) => self.tiles[tile].turn..self.tiles[tile].turn + 1,
            Half::Line(line) => self.lines[line].turns.clone(),
        }
    }
}

impl Cutter {
    /// The pixels of some tiles and the lines between them: left, top, right, bottom.
    fn bounds(&self, i: &Range<usize>, j: &Range<usize>) -> [usize; 4] {
        let end = |[start, length]: [usize; 2]| start + length;
        let (first, last) = (self.across[i.start], self.across[i.end - 1]);
        let (top, bottom) = (self.down[j.start], self.down[j.end - 1]);
        [first[0], top[0], end(last), end(bottom)]
    }

    /// Cuts some tiles apart by a line.
    fn cut(&mut self, i: Range<usize>, j: Range<usize>) -> Half {
        let [left, top, right, bottom] = self.bounds(&i, &j);
        let tiles = i.len() * j.len();
        let first = self.turn;
        if tiles == 1 {
            let tile = j.start * self.across.len() + i.start;
            self.plan.tiles[tile].turn = self.turn;
            self.turn += 1;
            return Half::Tile(tile);
        }
        let width = self.plan.width;
        let upright = i.len() > 1 && (right - left >= bottom - top || j.len() == 1);
        let (halves, own): (_, Vec<u32>) = if upright {
            let middle = i.start + i.len() / 2;
            let x = self.across[middle][0] - 1;
            let one = self.cut(i.start..middle, j.clone());
            let two = self.cut(middle..i.end, j);
            let own = (top..bottom).map(|y| (y * width + x) as u32);
            ([one, two], own.collect())
        } else {
            let middle = j.start + j.len() / 2;
            let y = self.down[middle][0] - 1;
            let one = self.cut(i.clone(), j.start..middle);
            let two = self.cut(i, middle..j.end);
            let own = (left..right).map(|x| (y * width + x) as u32);
            ([one, two], own.collect())
        };
        let line = self.plan.lines.len();
        for (place, &pixel) in own.iter().enumerate() {
            self.plan.homes[pixel as usize] = Home::Line(line as u32, place as u32);
        }
        self.turn += 1;
        // The pixels around the region; those of later lines only, once these are known.
        let (x, y) = (left as i64..right as i64, top as i64..bottom as i64);
        let sides = y.clone().flat_map(|v| [(x.start - 1, v), (x.end, v)]);
        let ends = x.clone().flat_map(|u| [(u, y.start - 1), (u, y.end)]);
        let size = [width as i64, self.plan.height as i64];
        let inside = |&(u, v): &(i64, i64)| (0..size[0]).contains(&u) && (0..size[1]).contains(&v);
        let corners = [x.start - 1, x.end].map(|u| [y.start - 1, y.end].map(|v| (u, v)));
        let eight = self.plan.neighbours == Neighbours::Eight;
        let corners = corners.into_iter().flatten().filter(|_| eight);
        let around = sides.chain(ends).chain(corners).filter(inside);
        self.plan.lines.push(Line {
            own,
            kept: around.map(|(u, v)| (v * size[0] + u) as u32).collect(),
            rows: 0,
            start: 0,
            first: self.plan.lengths.pixels,
            halves,
            places: [Vec::new(), Vec::new()],
            runs: [Vec::new(), Vec::new()],
            entries: Vec::new(),
            room: 0,
            tiles,
            turns: first..self.turn,
        });
        self.plan.lengths.pixels += self.plan.lines[line].own.len();
        Half::Line(line)
    }

    /// Finds what a line keeps, reads, and takes from its halves.
    fn link(&mut self, line: usize) {
        let width = self.plan.width;
        let mut kept = std::mem::take(&mut self.plan.lines[line].kept);
        kept.sort_by_key(|&pixel| self.plan.turn(pixel));
        let plan = &self.plan;
        let own = &plan.lines[line];
        let all = own.own.iter().chain(&kept);
        let rows: HashMap<u32, u32> = all.zip(0..).map(|(&pixel, row)| (pixel, row)).collect();
        let mut entries = Vec::new();
        for (column, &pixel) in own.own.iter().enumerate() {
            let (x, y) = (pixel as usize % width, pixel as usize / width);
            let mut add = |row: usize, entry, dx: i32, dy: i32| {
                let (x, y) = (x as i64 + i64::from(dx), y as i64 + i64::from(dy));
                let place = padded(width, x as usize, y as usize);
                entries.push((row as u32, column as u32, entry, place as u32));
            };
            add(column, Entry::Own, 0, 0);
            for &([dx, dy], entry, [ex, ey]) in plan.neighbours.list() {
                let (u, v) = (x as i64 + i64::from(dx), y as i64 + i64::from(dy));
                if !(0..width as i64).contains(&u) || !(0..plan.height as i64).contains(&v) {
                    continue;
                }
                let other = (v * width as i64 + u) as u32;
                if let Some(&row) = rows.get(&other).filter(|&&row| row as usize > column) {
                    add(row as usize, entry, ex, ey);
                }
            }
        }
        let places = own.halves.map(|half| match half {
            Half::Line(half) => {
                let kept = plan.lines[half].kept.iter();
                kept.map(|pixel| rows.get(pixel).copied())
                    .collect::<Vec<_>>()
            }
            Half::Tile(tile) => {
                let ring = plan.ring(tile);
                ring.map(|pixel| rows.get(&pixel?).copied()).collect()
            }
        });
        let mut room = 0;
        for half in own.halves.iter().rev() {
            if let Half::Line(half) = half {
                let half = &plan.lines[*half];
                let below = if own.tiles > FORK {
                    half.room + room
                } else {
                    half.room.max(room)
                };
                room = half.square() + below;
            }
        }
        let count = own.own.len();
        let start = self.plan.lengths.lines;
        let own = &mut self.plan.lines[line];
        own.rows = count + kept.len().next_multiple_of(PAD);
        own.start = start;
        own.runs = std::array::from_fn(|i| runs(places[i].iter().copied(), count));
        own.places = places;
        own.entries = entries;
        own.kept = kept;
        own.room = room;
        self.plan.lengths.lines += own.rows * count;
    }
}
