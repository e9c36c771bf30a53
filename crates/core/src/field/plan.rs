//! The order of elimination of the pixels of a grid, and the layout of all values: everything that depends only on the size of
//! the grid and on the connectivity of its pixels.
//!
//! Separators, lines one pixel wide, divide the grid into tiles. The tiles are eliminated first, then the separators between
//! them, in the order of nested dissection (George 1973): each separator after the two parts that it separates, its children.

use super::runs::{IndexRun, runs};
use super::stencil::{Connectivity, MatrixEntry, padded};
use super::symbolic::SymbolicFactor;
use lsdc_kernels::cholesky::PAD;
use std::collections::HashMap;
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Approximate side of a tile: the fastest of 7 to 23, by a small margin.
const SIDE: usize = 15;

/// Number of tiles above which children are eliminated in parallel.
pub(super) const FORK: usize = 8;

/// A rectangle between separators.
#[derive(Debug)]
pub(super) struct Tile {
    pub(super) left: usize,
    pub(super) top: usize,
    /// Batch of the tile, and its lane among eight.
    pub(super) batch: usize,
    pub(super) lane: usize,
    /// Its rank in the order of elimination, among tiles and separators.
    pub(super) turn: u32,
}

/// Up to eight tiles of a shape.
#[derive(Debug)]
pub(super) struct TileBatch {
    pub(super) symbolic: usize,
    pub(super) tiles: Vec<usize>,
    /// Start in the factors and the update matrices of all tiles.
    pub(super) factor: usize,
    pub(super) update: usize,
}

/// One of the two parts divided by a separator.
#[derive(Clone, Copy, Debug)]
pub(super) enum Child {
    Tile(usize),
    Separator(usize),
}

/// The elimination of a separator.
#[derive(Debug)]
pub(super) struct Separator {
    /// Pixels of the separator.
    pub(super) own: Vec<u32>,
    /// The later pixels that depend on these, in the order of their elimination.
    pub(super) boundary: Vec<u32>,
    /// Rows of the factor: own, then boundary, padded.
    pub(super) rows: usize,
    /// Start of its columns in the factor of all separators.
    pub(super) start: usize,
    /// Start of its pixels among those of all separators.
    pub(super) first: usize,
    pub(super) children: [Child; 2],
    /// The row in the front of each variable of the children's boundaries; `None` for positions in a tile's ring without a
    /// pixel.
    pub(super) places: [Vec<Option<u32>>; 2],
    /// These rows as runs.
    pub(super) runs: [Vec<IndexRun>; 2],
    /// Row, column, kind and place of each entry of the matrix.
    pub(super) entries: Vec<(u32, u32, MatrixEntry, u32)>,
    /// The workspace of the children.
    pub(super) workspace: usize,
    /// Number of tiles in both children.
    pub(super) tiles: usize,
    /// The turns of its children and its own.
    pub(super) turns: Range<u32>,
}

impl Separator {
    /// Returns the number of variables of the boundary, padded.
    pub(super) fn padded(&self) -> usize {
        self.rows - self.own.len()
    }

    /// Returns the length of its update matrix.
    pub(super) fn square(&self) -> usize {
        self.padded() * self.padded()
    }
}

/// Location of a pixel in the elimination: in a tile, with its rank there, or in a separator.
#[derive(Clone, Copy, Debug)]
pub(super) enum PixelLocation {
    Tile(u32, u32),
    Separator(u32, u32),
}

/// Numbers of values in each buffer.
#[derive(Debug, Default)]
pub(super) struct Lengths {
    /// Factors of tiles, eight at a time.
    pub(super) tiles: usize,
    /// Update matrices of tiles.
    pub(super) updates: usize,
    /// Factors of separators.
    pub(super) separators: usize,
    /// Pixels of separators.
    pixels: usize,
}

/// The elimination of grids of one size.
#[derive(Debug)]
pub(crate) struct Plan {
    pub(super) height: usize,
    pub(super) width: usize,
    neighbours: Connectivity,
    pub(super) symbolic_factors: Vec<SymbolicFactor>,
    pub(super) tiles: Vec<Tile>,
    pub(super) batches: Vec<TileBatch>,
    /// Separators; children precede their separator.
    pub(super) separators: Vec<Separator>,
    pub(super) locations: Vec<PixelLocation>,
    /// The whole grid.
    pub(super) root: Child,
    pub(super) lengths: Lengths,
}

/// Spans of tiles along an axis: start and length of each.
type Spans = Vec<[usize; 2]>;

/// Divides a length into spans of about `SIDE`, with one pixel between them.
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

/// A plan under construction.
struct Dissection {
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

/// Frees the plans that no field uses.
pub(super) fn free_plans() {
    plans().clear();
}

impl Plan {
    /// The plan of a size, made once for the last few sizes.
    pub(super) fn of(height: usize, width: usize, neighbours: Connectivity) -> Arc<Self> {
        /// Number of plans in the cache.
        const KEPT: usize = 4;
        let key = (height, width, neighbours);
        let same = |plan: &Arc<Self>| (plan.height, plan.width, plan.neighbours) == key;
        let known = {
            let mut plans = plans();
            plans.iter().position(same).map(|at| plans.remove(at))
        };
        let plan = known.unwrap_or_else(|| Arc::new(Self::new(height, width, neighbours)));
        let mut plans = plans();
        if !plans.iter().any(same) {
            plans.insert(0, plan.clone());
            plans.truncate(KEPT);
        }
        plan
    }

    pub(super) fn new(height: usize, width: usize, neighbours: Connectivity) -> Self {
        let (across, down) = (spans(width), spans(height));
        let mut shapes = HashMap::new();
        let mut symbolic_factors = Vec::new();
        let mut tiles = Vec::new();
        let mut members: Vec<Vec<usize>> = Vec::new();
        for &[top, height] in &down {
            for &[left, width] in &across {
                let symbolic = *shapes.entry((width, height)).or_insert_with(|| {
                    symbolic_factors.push(SymbolicFactor::new(width, height, neighbours));
                    members.push(Vec::new());
                    symbolic_factors.len() - 1
                });
                members[symbolic].push(tiles.len());
                tiles.push(Tile {
                    left,
                    top,
                    batch: 0,
                    lane: 0,
                    turn: 0,
                });
            }
        }
        let mut batches: Vec<TileBatch> = Vec::new();
        let mut lengths = Lengths::default();
        for (symbolic, members) in members.into_iter().enumerate() {
            for eight in members.chunks(8) {
                for (lane, &tile) in eight.iter().enumerate() {
                    tiles[tile].batch = batches.len();
                    tiles[tile].lane = lane;
                }
                batches.push(TileBatch {
                    symbolic,
                    tiles: eight.to_vec(),
                    factor: lengths.tiles,
                    update: lengths.updates,
                });
                lengths.tiles += symbolic_factors[symbolic].length;
                lengths.updates += 8 * symbolic_factors[symbolic].ring.len().pow(2);
            }
        }
        let mut locations = vec![PixelLocation::Separator(0, 0); height * width];
        for (t, tile) in tiles.iter().enumerate() {
            let symbolic: &SymbolicFactor = &symbolic_factors[batches[tile.batch].symbolic];
            for (i, &(x, y)) in symbolic.order.iter().enumerate() {
                locations[(tile.top + y) * width + tile.left + x] =
                    PixelLocation::Tile(t as u32, i as u32);
            }
        }
        let (i, j) = (0..across.len(), 0..down.len());
        let mut cutter = Dissection {
            plan: Self {
                height,
                width,
                neighbours,
                symbolic_factors,
                tiles,
                batches,
                separators: Vec::new(),
                locations,
                root: Child::Tile(0),
                lengths,
            },
            across,
            down,
            turn: 0,
        };
        cutter.plan.root = cutter.dissect(i, j);
        for separator in 0..cutter.plan.separators.len() {
            cutter.link(separator);
        }
        cutter.plan
    }

    /// The number of pixels.
    pub(super) fn len(&self) -> usize {
        self.locations.len()
    }

    pub(super) fn symbolic(&self, tile: usize) -> &SymbolicFactor {
        &self.symbolic_factors[self.batches[self.tiles[tile].batch].symbolic]
    }

    /// The pixels around a tile, in the order of its ring.
    pub(super) fn ring(&self, tile: usize) -> impl Iterator<Item = Option<u32>> {
        let Tile { left, top, .. } = self.tiles[tile];
        let ring = self.symbolic(tile).ring.iter();
        ring.map(move |&(x, y)| {
            let (x, y) = (left as i64 + i64::from(x), top as i64 + i64::from(y));
            let inside =
                (0..self.width as i64).contains(&x) && (0..self.height as i64).contains(&y);
            inside.then(|| (y * self.width as i64 + x) as u32)
        })
    }

    /// The turn of a pixel's tile or separator, and its place there.
    pub(super) fn turn(&self, pixel: u32) -> (u32, u32) {
        match self.locations[pixel as usize] {
            PixelLocation::Tile(tile, at) => (self.tiles[tile as usize].turn, at),
            PixelLocation::Separator(separator, at) => {
                (self.separators[separator as usize].turns.end - 1, at)
            }
        }
    }

    /// The turns of a child.
    pub(super) fn turns(&self, child: Child) -> Range<u32> {
        match child {
            Child::Tile(tile) => self.tiles[tile].turn..self.tiles[tile].turn + 1,
            Child::Separator(separator) => self.separators[separator].turns.clone(),
        }
    }
}

impl Dissection {
    /// Returns the bounds of some tiles and the separators between them: left, top, right, bottom.
    fn bounds(&self, i: &Range<usize>, j: &Range<usize>) -> [usize; 4] {
        let end = |[start, length]: [usize; 2]| start + length;
        let (first, last) = (self.across[i.start], self.across[i.end - 1]);
        let (top, bottom) = (self.down[j.start], self.down[j.end - 1]);
        [first[0], top[0], end(last), end(bottom)]
    }

    /// Divides some tiles by a separator.
    fn dissect(&mut self, i: Range<usize>, j: Range<usize>) -> Child {
        let [left, top, right, bottom] = self.bounds(&i, &j);
        let tiles = i.len() * j.len();
        let first = self.turn;
        if tiles == 1 {
            let tile = j.start * self.across.len() + i.start;
            self.plan.tiles[tile].turn = self.turn;
            self.turn += 1;
            return Child::Tile(tile);
        }
        let width = self.plan.width;
        let upright = i.len() > 1 && (right - left >= bottom - top || j.len() == 1);
        let (children, own): (_, Vec<u32>) = if upright {
            let middle = i.start + i.len() / 2;
            let x = self.across[middle][0] - 1;
            let one = self.dissect(i.start..middle, j.clone());
            let two = self.dissect(middle..i.end, j);
            let own = (top..bottom).map(|y| (y * width + x) as u32);
            ([one, two], own.collect())
        } else {
            let middle = j.start + j.len() / 2;
            let y = self.down[middle][0] - 1;
            let one = self.dissect(i.clone(), j.start..middle);
            let two = self.dissect(i, middle..j.end);
            let own = (left..right).map(|x| (y * width + x) as u32);
            ([one, two], own.collect())
        };
        let separator = self.plan.separators.len();
        for (place, &pixel) in own.iter().enumerate() {
            self.plan.locations[pixel as usize] =
                PixelLocation::Separator(separator as u32, place as u32);
        }
        self.turn += 1;
        // The pixels around the region; reduced to those of later separators when these are known.
        let (x, y) = (left as i64..right as i64, top as i64..bottom as i64);
        let sides = y.clone().flat_map(|v| [(x.start - 1, v), (x.end, v)]);
        let ends = x.clone().flat_map(|u| [(u, y.start - 1), (u, y.end)]);
        let size = [width as i64, self.plan.height as i64];
        let inside = |&(u, v): &(i64, i64)| (0..size[0]).contains(&u) && (0..size[1]).contains(&v);
        let corners = [x.start - 1, x.end].map(|u| [y.start - 1, y.end].map(|v| (u, v)));
        let eight = self.plan.neighbours == Connectivity::Eight;
        let corners = corners.into_iter().flatten().filter(|_| eight);
        let around = sides.chain(ends).chain(corners).filter(inside);
        self.plan.separators.push(Separator {
            own,
            boundary: around.map(|(u, v)| (v * size[0] + u) as u32).collect(),
            rows: 0,
            start: 0,
            first: self.plan.lengths.pixels,
            children,
            places: [Vec::new(), Vec::new()],
            runs: [Vec::new(), Vec::new()],
            entries: Vec::new(),
            workspace: 0,
            tiles,
            turns: first..self.turn,
        });
        self.plan.lengths.pixels += self.plan.separators[separator].own.len();
        Child::Separator(separator)
    }

    /// Finds the boundary of a separator, the entries that it reads, and the rows of its children.
    fn link(&mut self, separator: usize) {
        let width = self.plan.width;
        let mut boundary = std::mem::take(&mut self.plan.separators[separator].boundary);
        boundary.sort_by_key(|&pixel| self.plan.turn(pixel));
        let plan = &self.plan;
        let own = &plan.separators[separator];
        let all = own.own.iter().chain(&boundary);
        let rows: HashMap<u32, u32> = all.zip(0..).map(|(&pixel, row)| (pixel, row)).collect();
        let mut entries = Vec::new();
        for (column, &pixel) in own.own.iter().enumerate() {
            let (x, y) = (pixel as usize % width, pixel as usize / width);
            let mut add = |row: usize, entry, dx: i32, dy: i32| {
                let (x, y) = (x as i64 + i64::from(dx), y as i64 + i64::from(dy));
                let place = padded(width, x as usize, y as usize);
                entries.push((row as u32, column as u32, entry, place as u32));
            };
            add(column, MatrixEntry::Own, 0, 0);
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
        let places = own.children.map(|child| match child {
            Child::Separator(child) => {
                let boundary = plan.separators[child].boundary.iter();
                boundary
                    .map(|pixel| rows.get(pixel).copied())
                    .collect::<Vec<_>>()
            }
            Child::Tile(tile) => {
                let ring = plan.ring(tile);
                ring.map(|pixel| rows.get(&pixel?).copied()).collect()
            }
        });
        let mut workspace = 0;
        for child in own.children.iter().rev() {
            if let Child::Separator(child) = child {
                let child = &plan.separators[*child];
                let below = if own.tiles > FORK {
                    child.workspace + workspace
                } else {
                    child.workspace.max(workspace)
                };
                workspace = child.square() + below;
            }
        }
        let count = own.own.len();
        let start = self.plan.lengths.separators;
        let own = &mut self.plan.separators[separator];
        own.rows = count + boundary.len().next_multiple_of(PAD);
        own.start = start;
        own.runs = std::array::from_fn(|i| runs(places[i].iter().copied(), count));
        own.places = places;
        own.entries = entries;
        own.boundary = boundary;
        own.workspace = workspace;
        self.plan.lengths.separators += own.rows * count;
    }
}
