//! The elimination of a tile: a small rectangle of pixels whose shape determines every step, so that eight tiles of one shape
//! are eliminated at once, one in each lane of a vector.
//!
//! Within a tile the order is again nested dissection. Its pixels are numbered in the order of elimination, followed by the
//! pixels around it, its ring.

use super::runs::{IndexRun, runs};
use super::stencil::{Connectivity, MatrixEntry};
use lsdc_kernels::cholesky::{F64x8, factorise_eight};
use lsdc_kernels::simd::Level;

/// Largest number of pixels of a region that is not divided further.
const LEAF: usize = 9;

/// Boundaries are padded to multiples of this.
const PAD: usize = 4;

/// The elimination of a separator or leaf of a tile.
#[derive(Debug)]
pub(super) struct PivotStep {
    /// The first variable eliminated by this step.
    pub(super) first: usize,
    /// Number of eliminated variables.
    pub(super) count: usize,
    /// Later variables that depend on the eliminated ones, in order.
    pub(super) boundary: Vec<u32>,
    /// Rows of the factor: the eliminated variables, then `boundary`, padded.
    pub(super) rows: usize,
    /// Start of its columns in the factor of the tile.
    pub(super) start: usize,
    /// The steps of the children, and the rows of their boundaries in the front.
    pub(super) children: Vec<(usize, Vec<IndexRun>)>,
    /// Row, column, and index among the sources.
    pub(super) entries: Vec<[u32; 3]>,
    /// The workspace of the children.
    workspace: usize,
}

impl PivotStep {
    fn padded(&self) -> usize {
        self.rows - self.count
    }

    /// Returns the length of its update matrix.
    fn square(&self) -> usize {
        self.padded() * self.padded()
    }
}

/// An entry of the matrix read by a tile: its kind, and the offset of its pixel from the tile's first pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct EntrySource {
    pub(super) entry: MatrixEntry,
    pub(super) x: i32,
    pub(super) y: i32,
}

/// The elimination of tiles of one shape.
#[derive(Debug)]
pub(super) struct SymbolicFactor {
    /// The pixels of the tile in the order of elimination, as (x, y) from its first pixel.
    pub(super) order: Vec<(usize, usize)>,
    /// The offsets of the pixels of the ring.
    pub(super) ring: Vec<(i32, i32)>,
    pub(super) steps: Vec<PivotStep>,
    pub(super) sources: Vec<EntrySource>,
    /// Number of values of the factor.
    pub(super) length: usize,
}

/// A rectangle of the tile.
#[derive(Clone, Copy)]
struct Rectangle {
    x: usize,
    y: usize,
    width: usize,
    height: usize,
}

impl Rectangle {
    /// Returns two parts and the line of pixels between them; `None` for a leaf.
    fn dissect(self) -> Option<([Self; 2], Self)> {
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
        let middle = length / 2;
        let children = [along(0, middle), along(middle + 1, length - middle - 1)];
        Some((children, along(middle, 1)))
    }
}

impl SymbolicFactor {
    pub(super) fn new(width: usize, height: usize, neighbours: Connectivity) -> Self {
        let mut symbolic = Self {
            order: Vec::with_capacity(width * height),
            ring: ring(width as i32, height as i32, neighbours),
            steps: Vec::new(),
            sources: Vec::new(),
            length: 0,
        };
        let whole = Rectangle {
            x: 0,
            y: 0,
            width,
            height,
        };
        symbolic.dissect(whole);
        symbolic.link(width, height, neighbours);
        symbolic
    }

    /// Orders the pixels of a part, and returns its step.
    fn dissect(&mut self, part: Rectangle) -> usize {
        let (children, own) = match part.dissect() {
            Some((children, separator)) => (Some(children), separator),
            None => (None, part),
        };
        let children =
            children.map(|children| children.map(|child| (self.dissect(child), Vec::new())));
        let first = self.order.len();
        for y in own.y..own.y + own.height {
            self.order
                .extend((own.x..own.x + own.width).map(|x| (x, y)));
        }
        self.steps.push(PivotStep {
            first,
            count: own.width * own.height,
            boundary: Vec::new(),
            rows: 0,
            start: 0,
            children: children.into_iter().flatten().collect(),
            entries: Vec::new(),
            workspace: 0,
        });
        self.steps.len() - 1
    }

    /// Finds the boundary of each step, the entries that it reads, and the rows of its children.
    fn link(&mut self, width: usize, height: usize, neighbours: Connectivity) {
        let across = width as i32 + 2;
        let index = |x: i32, y: i32| ((y + 1) * across + x + 1) as usize;
        let mut numbers = vec![u32::MAX; across as usize * (height + 2)];
        let order = self.order.iter().map(|&(x, y)| (x as i32, y as i32));
        for (number, (x, y)) in order.chain(self.ring.iter().copied()).enumerate() {
            numbers[index(x, y)] = number as u32;
        }
        let mut sources = vec![[u32::MAX; 5]; numbers.len()];
        for s in 0..self.steps.len() {
            let (done, later) = self.steps.split_at_mut(s);
            let step = &mut later[0];
            let end = (step.first + step.count) as u32;
            let mut boundary: Vec<u32> = step
                .children
                .iter()
                .flat_map(|&(child, _)| &done[child].boundary)
                .copied()
                .collect();
            let own = step.first..step.first + step.count;
            let mut joins = Vec::new();
            for (column, &(x, y)) in self.order[own].iter().enumerate() {
                let (x, y) = (x as i32, y as i32);
                joins.push((
                    step.first as u32 + column as u32,
                    column,
                    x,
                    y,
                    MatrixEntry::Own,
                ));
                for &([dx, dy], entry, [ex, ey]) in neighbours.list() {
                    let number = numbers[index(x + dx, y + dy)];
                    if number as usize > step.first + column {
                        joins.push((number, column, x + ex, y + ey, entry));
                        boundary.push(number);
                    }
                }
            }
            boundary.retain(|&number| number >= end);
            boundary.sort_unstable();
            boundary.dedup();
            let row = |number: u32| {
                if number < end {
                    return number - step.first as u32;
                }
                let place = boundary.partition_point(|&other| other < number);
                (step.count + place) as u32
            };
            for (number, column, x, y, entry) in joins {
                let source = &mut sources[index(x, y)][entry as usize];
                if *source == u32::MAX {
                    *source = self.sources.len() as u32;
                    self.sources.push(EntrySource { entry, x, y });
                }
                step.entries.push([row(number), column as u32, *source]);
            }
            let mut workspace = 0;
            for (child, own) in step.children.iter_mut().rev() {
                let child = &done[*child];
                let rows = child.boundary.iter().map(|&number| Some(row(number)));
                *own = runs(rows, step.count);
                workspace = child.square() + child.workspace.max(workspace);
            }
            step.workspace = workspace;
            step.rows = step.count + boundary.len().next_multiple_of(PAD);
            step.start = self.length;
            step.boundary = boundary;
            self.length += step.rows * step.count;
        }
    }

    /// The last step, whose boundary is the ring.
    pub(super) fn last(&self) -> &PivotStep {
        &self.steps[self.steps.len() - 1]
    }

    /// Returns the number of values of the update matrix, `[padded ring, padded ring]`.
    pub(super) fn update(&self) -> usize {
        self.last().square()
    }

    /// Extracts the update matrices of eight tiles, `[ring, ring]` each; only lower halves are set.
    #[inline(always)]
    pub(super) fn part(&self, update: &[F64x8], parts: &mut [f64]) {
        let (ring, stride) = (self.ring.len(), self.last().padded());
        for j in 0..ring {
            let column = &update[j * stride..][..ring];
            for (i, value) in column.iter().enumerate().skip(j) {
                for (lane, value) in value.iter().enumerate() {
                    parts[(lane * ring + j) * ring + i] = *value;
                }
            }
        }
    }

    /// The length of the workspace of [`Self::eliminate`].
    pub(super) fn workspace(&self) -> usize {
        self.last().workspace
    }

    /// Eliminates a step, normally the last, and all steps below it for eight tiles, whose entries are in the order of the
    /// sources.
    pub(super) fn eliminate(
        &self,
        step: &PivotStep,
        level: Level,
        entries: &[F64x8],
        factor: &mut [F64x8],
        update: &mut [F64x8],
        workspace: &mut [F64x8],
    ) -> bool {
        let mut updates: [&mut [F64x8]; 2] = [&mut [], &mut []];
        let mut workspace = workspace;
        for ((child, _), part) in step.children.iter().zip(&mut updates) {
            let child = &self.steps[*child];
            let (own, left) = workspace.split_at_mut(child.square());
            if !self.eliminate(child, level, entries, factor, own, left) {
                return false;
            }
            (*part, workspace) = (own, left);
        }
        let panel = &mut factor[step.start..][..step.rows * step.count];
        level.vectorised(
            #[inline(always)]
            || step.assemble(entries, panel, update, &self.steps, &updates),
        );
        factorise_eight(level, panel, step.count, update)
    }
}

impl PivotStep {
    #[inline(always)]
    fn assemble(
        &self,
        entries: &[F64x8],
        panel: &mut [F64x8],
        update: &mut [F64x8],
        steps: &[Self],
        updates: &[&mut [F64x8]; 2],
    ) {
        let padded = self.padded();
        panel.fill([0.0; 8]);
        for (j, column) in update.chunks_exact_mut(padded.max(1)).enumerate() {
            column[j..].fill([0.0; 8]);
        }
        for &[row, column, source] in &self.entries {
            panel[column as usize * self.rows + row as usize] = entries[source as usize];
        }
        for ((child, runs), values) in self.children.iter().zip(updates) {
            let stride = steps[*child].padded();
            for (r, run) in runs.iter().enumerate() {
                for (j, to) in run.from.clone().zip(run.to..) {
                    let (target, first) = match to.checked_sub(self.count) {
                        None => (&mut panel[to * self.rows..][..self.rows], 0),
                        Some(boundary) => (&mut update[boundary * padded..][..padded], self.count),
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
fn add(target: &mut [F64x8], values: &[F64x8]) {
    for (target, value) in target.iter_mut().zip(values) {
        target.iter_mut().zip(value).for_each(|(t, v)| *t += v);
    }
}

/// The pixels around a rectangle, side by side, with the corners if they are neighbours.
fn ring(width: i32, height: i32, neighbours: Connectivity) -> Vec<(i32, i32)> {
    let sides = [-1, width].into_iter();
    let ends = [-1, height].into_iter();
    let sides = sides.flat_map(|x| (0..height).map(move |y| (x, y)));
    let ends = ends.flat_map(|y| (0..width).map(move |x| (x, y)));
    let corners = [(-1, -1), (width, -1), (-1, height), (width, height)];
    let corners = corners
        .into_iter()
        .filter(|_| neighbours == Connectivity::Eight);
    sides.chain(ends).chain(corners).collect()
}
