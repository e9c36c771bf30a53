//! Forward and backward substitution, for one column or a few columns at once.

use super::factor::{Factor, both};
use super::plan::{Child, FORK, Separator};
use super::symbolic::{PivotStep, SymbolicFactor};
use lsdc_kernels::cholesky::F64x8;
use lsdc_kernels::schedule::InTasks;
use rayon::prelude::*;

/// Values of `B` columns.
pub(super) type Row<const B: usize> = [f64; B];

/// Rows of eight tiles.
pub(super) type Rows<const B: usize> = [Row<B>; 8];

impl Factor {
    /// Computes `L^-1 values` in place: each value of the result is stored at the pixel that its column eliminates.
    pub(super) fn forward<const B: usize>(&self, values: &mut [Row<B>]) {
        let plan = &*self.plan;
        let swept: Vec<Vec<Rows<B>>> = plan.batches.par_iter().gather(|batch| {
            let symbolic = &plan.symbolic_factors[batch.symbolic];
            let mut x = self.gathered(&batch.tiles, symbolic, values);
            let factor = &self.tiles[batch.factor..][..symbolic.length];
            self.level.vectorised(
                #[inline(always)]
                || symbolic.forward(factor, &mut x),
            );
            x
        });
        self.scatter(&swept, values);
        if let Child::Separator(root) = plan.root {
            let mut packed = self.packed(values);
            self.forward_through_tree(root, &mut packed, 0, &swept);
            self.unpack(&packed, values);
        }
    }

    /// Computes `L'^-1 values` in place.
    pub(super) fn backward<const B: usize>(&self, values: &mut [Row<B>]) {
        let plan = &*self.plan;
        if let Child::Separator(root) = plan.root {
            let mut packed = self.packed(values);
            self.backward_through_tree(root, &mut packed, 0, &[]);
            self.unpack(&packed, values);
        }
        let known: &[Row<B>] = values;
        let swept: Vec<Vec<Rows<B>>> = plan.batches.par_iter().gather(|batch| {
            let symbolic = &plan.symbolic_factors[batch.symbolic];
            let mut x = self.gathered(&batch.tiles, symbolic, known);
            for (lane, &tile) in batch.tiles.iter().enumerate() {
                let ring = x[symbolic.order.len()..].iter_mut().zip(plan.ring(tile));
                ring.for_each(|(value, pixel)| {
                    value[lane] = pixel.map_or([0.0; B], |pixel| known[pixel as usize]);
                });
            }
            let factor = &self.tiles[batch.factor..][..symbolic.length];
            self.level.vectorised(
                #[inline(always)]
                || symbolic.backward(factor, &mut x),
            );
            x
        });
        self.scatter(&swept, values);
    }

    /// Returns the values of the pixels of up to eight tiles, followed by zeros for their rings.
    fn gathered<const B: usize>(
        &self,
        tiles: &[usize],
        symbolic: &SymbolicFactor,
        values: &[Row<B>],
    ) -> Vec<Rows<B>> {
        let width = self.plan.width;
        let mut x = vec![[[0.0; B]; 8]; symbolic.order.len() + symbolic.ring.len()];
        for (lane, &tile) in tiles.iter().enumerate() {
            let tile = &self.plan.tiles[tile];
            for (x, &(u, v)) in x.iter_mut().zip(&symbolic.order) {
                x[lane] = values[(tile.top + v) * width + tile.left + u];
            }
        }
        x
    }

    fn scatter<const B: usize>(&self, swept: &[Vec<Rows<B>>], values: &mut [Row<B>]) {
        let (plan, width) = (&*self.plan, self.plan.width);
        for (batch, x) in plan.batches.iter().zip(swept) {
            let symbolic = &plan.symbolic_factors[batch.symbolic];
            for (lane, &tile) in batch.tiles.iter().enumerate() {
                let tile = &plan.tiles[tile];
                for (x, &(u, v)) in x.iter().zip(&symbolic.order) {
                    values[(tile.top + v) * width + tile.left + u] = x[lane];
                }
            }
        }
    }

    /// The values of the pixels of separators, in the order of these.
    fn packed<const B: usize>(&self, values: &[Row<B>]) -> Vec<Row<B>> {
        let pixels = self
            .plan
            .separators
            .iter()
            .flat_map(|separator| &separator.own);
        pixels.map(|&pixel| values[pixel as usize]).collect()
    }

    fn unpack<const B: usize>(&self, packed: &[Row<B>], values: &mut [Row<B>]) {
        let pixels = self
            .plan
            .separators
            .iter()
            .flat_map(|separator| &separator.own);
        for (&pixel, value) in pixels.zip(packed) {
            values[pixel as usize] = *value;
        }
    }

    /// Substitutes forward up to a separator, and returns the update of its boundary. `packed` holds the values of its
    /// separators, starting at `base`.
    fn forward_through_tree<const B: usize>(
        &self,
        at: usize,
        packed: &mut [Row<B>],
        base: usize,
        swept: &[Vec<Rows<B>>],
    ) -> Vec<Row<B>> {
        let plan = &*self.plan;
        let separator = &plan.separators[at];
        let (below, own) = packed.split_at_mut(separator.first - base);
        let mut values = vec![[0.0; B]; separator.rows];
        values[..separator.own.len()].copy_from_slice(&own[..separator.own.len()]);
        let added = if let [Child::Separator(one), Child::Separator(two)] = separator.children {
            let split = plan.separators[one].first + plan.separators[one].own.len() - base;
            let (first, second) = below.split_at_mut(split);
            let (one, two) = both(
                separator.tiles > FORK,
                || self.forward_through_tree(one, first, base, swept),
                || self.forward_through_tree(two, second, base + split, swept),
            );
            [one, two]
        } else {
            separator.children.map(|child| match child {
                Child::Separator(child) => self.forward_through_tree(child, below, base, swept),
                Child::Tile(tile) => {
                    let tile = &plan.tiles[tile];
                    let symbolic = &plan.symbolic_factors[plan.batches[tile.batch].symbolic];
                    let ring = &swept[tile.batch][symbolic.order.len()..];
                    ring.iter().map(|value| value[tile.lane]).collect()
                }
            })
        };
        for (added, places) in added.iter().zip(&separator.places) {
            for (value, place) in added.iter().zip(places) {
                if let Some(place) = place {
                    let sum = values[*place as usize].iter_mut().zip(value);
                    sum.for_each(|(sum, value)| *sum += value);
                }
            }
        }
        let columns = self.columns(separator).chunks_exact(separator.rows);
        self.level.vectorised(
            #[inline(always)]
            || {
                for (j, column) in columns.enumerate() {
                    let value = values[j].map(|value| value / column[j]);
                    values[j] = value;
                    let later = values[j + 1..].iter_mut().zip(&column[j + 1..]);
                    later.for_each(|(other, factor)| {
                        for b in 0..B {
                            other[b] -= factor * value[b];
                        }
                    });
                }
            },
        );
        own[..separator.own.len()].copy_from_slice(&values[..separator.own.len()]);
        values.drain(..separator.own.len());
        values.truncate(separator.boundary.len());
        values
    }

    /// Substitutes backward from a separator down; `known` are the values of its boundary.
    fn backward_through_tree<const B: usize>(
        &self,
        at: usize,
        packed: &mut [Row<B>],
        base: usize,
        known: &[Row<B>],
    ) {
        let plan = &*self.plan;
        let separator = &plan.separators[at];
        let (below, own) = packed.split_at_mut(separator.first - base);
        let own = &mut own[..separator.own.len()];
        let mut values = vec![[0.0; B]; separator.rows];
        values[..own.len()].copy_from_slice(own);
        values[own.len()..][..known.len()].copy_from_slice(known);
        let columns = self.columns(separator);
        self.level.vectorised(
            #[inline(always)]
            || {
                for j in (0..separator.own.len()).rev() {
                    let column = &columns[j * separator.rows..][..separator.rows];
                    let known = products(&column[j + 1..], &values[j + 1..]);
                    for b in 0..B {
                        values[j][b] = (values[j][b] - known[b]) / column[j];
                    }
                }
            },
        );
        own.copy_from_slice(&values[..own.len()]);
        let known = |child: usize| boundary(separator, child, &values);
        if let [Child::Separator(one), Child::Separator(two)] = separator.children {
            let split = plan.separators[one].first + plan.separators[one].own.len() - base;
            let (first, second) = below.split_at_mut(split);
            let known = [known(0), known(1)];
            both(
                separator.tiles > FORK,
                || self.backward_through_tree(one, first, base, &known[0]),
                || self.backward_through_tree(two, second, base + split, &known[1]),
            );
        } else {
            for (i, child) in separator.children.into_iter().enumerate() {
                if let Child::Separator(child) = child {
                    self.backward_through_tree(child, below, base, &known(i));
                }
            }
        }
    }
}

/// Returns the values of the boundary of a child, from those of the front.
fn boundary<const B: usize>(separator: &Separator, child: usize, values: &[Row<B>]) -> Vec<Row<B>> {
    let places = separator.places[child].iter();
    places
        .map(|place| place.map_or([0.0; B], |place| values[place as usize]))
        .collect()
}

impl SymbolicFactor {
    /// `x` are the values of the tile's pixels and the update of its ring.
    #[inline(always)]
    pub(super) fn forward<const B: usize>(&self, factor: &[F64x8], x: &mut [Rows<B>]) {
        for step in &self.steps {
            for j in 0..step.count {
                let column = step.column(factor, j);
                let mut value = x[step.first + j];
                // True for most pixels if there are few points.
                if value == [[0.0; B]; 8] {
                    continue;
                }
                divide(&mut value, &column[j]);
                x[step.first + j] = value;
                for (i, factor) in column.iter().enumerate().take(step.count).skip(j + 1) {
                    subtract(&mut x[step.first + i], factor, &value);
                }
                for (&i, factor) in step.boundary.iter().zip(&column[step.count..]) {
                    subtract(&mut x[i as usize], factor, &value);
                }
            }
        }
    }

    /// `x` are the values of the tile's pixels and those of its ring.
    #[inline(always)]
    fn backward<const B: usize>(&self, factor: &[F64x8], x: &mut [Rows<B>]) {
        for step in self.steps.iter().rev() {
            for j in (0..step.count).rev() {
                let column = step.column(factor, j);
                let mut value = x[step.first + j];
                for (i, factor) in column.iter().enumerate().take(step.count).skip(j + 1) {
                    subtract(&mut value, factor, &x[step.first + i]);
                }
                for (&i, factor) in step.boundary.iter().zip(&column[step.count..]) {
                    subtract(&mut value, factor, &x[i as usize]);
                }
                divide(&mut value, &column[j]);
                x[step.first + j] = value;
            }
        }
    }
}

impl PivotStep {
    #[inline(always)]
    pub(super) fn column<'a>(&self, factor: &'a [F64x8], j: usize) -> &'a [F64x8] {
        &factor[self.start + j * self.rows..][..self.rows]
    }
}

#[inline(always)]
fn divide<const B: usize>(values: &mut Rows<B>, divisor: &F64x8) {
    for (values, divisor) in values.iter_mut().zip(divisor) {
        for value in values {
            *value /= divisor;
        }
    }
}

#[inline(always)]
fn subtract<const B: usize>(value: &mut Rows<B>, factor: &F64x8, other: &Rows<B>) {
    for lane in 0..8 {
        for b in 0..B {
            value[lane][b] -= factor[lane] * other[lane][b];
        }
    }
}

/// Computes `factors' rows`, with sums in lanes for vector units.
#[inline(always)]
fn products<const B: usize>(factors: &[f64], rows: &[Row<B>]) -> Row<B> {
    let mut lanes = [[0.0; B]; 8];
    let (whole, update) = (factors.chunks_exact(8), rows.chunks_exact(8));
    let mut sum = [0.0; B];
    for (factor, row) in whole.remainder().iter().zip(update.remainder()) {
        let sums = sum.iter_mut().zip(row);
        sums.for_each(|(sum, value)| *sum += factor * value);
    }
    for (factors, rows) in whole.zip(update) {
        for lane in 0..8 {
            for b in 0..B {
                lanes[lane][b] += factors[lane] * rows[lane][b];
            }
        }
    }
    for lane in lanes {
        sum.iter_mut()
            .zip(lane)
            .for_each(|(sum, lane)| *sum += lane);
    }
    sum
}
