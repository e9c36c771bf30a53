//! Forward and backward substitution.

use super::factor::{Factor, both};
use super::plan::{FORK, Half, Line};
use super::tile::{Program, Step};
use lsdc_kernels::cholesky::Eight;
use rayon::prelude::*;

impl Factor {
    /// `L^-1 values`, in place: each value of the result stands at the pixel that its column eliminates.
    pub(super) fn forward(&self, values: &mut [f64]) {
        let plan = &*self.plan;
        let batches = plan.batches.par_iter();
        let swept: Vec<Vec<Eight>> = batches
            .map(|batch| {
                let program = &plan.programs[batch.program];
                let mut x = self.gathered(batch.tiles.as_slice(), program, values);
                let factor = &self.tiles[batch.factor..][..program.length];
                self.level.vectorised(
                    #[inline(always)]
                    || program.forward(factor, &mut x),
                );
                x
            })
            .collect();
        self.scatter(&swept, values);
        if let Half::Line(root) = plan.root {
            let mut packed = self.packed(values);
            self.climb(root, &mut packed, 0, &swept);
            self.unpack(&packed, values);
        }
    }

    /// `L'^-1 values`, in place.
    pub(super) fn backward(&self, values: &mut [f64]) {
        let plan = &*self.plan;
        if let Half::Line(root) = plan.root {
            let mut packed = self.packed(values);
            self.descend(root, &mut packed, 0, &[]);
            self.unpack(&packed, values);
        }
        let batches = plan.batches.par_iter();
        let known: &[f64] = values;
        let swept: Vec<Vec<Eight>> = batches
            .map(|batch| {
                let program = &plan.programs[batch.program];
                let mut x = self.gathered(&batch.tiles, program, known);
                for (lane, &tile) in batch.tiles.iter().enumerate() {
                    let ring = x[program.order.len()..].iter_mut().zip(plan.ring(tile));
                    ring.for_each(|(value, pixel)| {
                        value[lane] = pixel.map_or(0.0, |pixel| known[pixel as usize]);
                    });
                }
                let factor = &self.tiles[batch.factor..][..program.length];
                self.level.vectorised(
                    #[inline(always)]
                    || program.backward(factor, &mut x),
                );
                x
            })
            .collect();
        self.scatter(&swept, values);
    }

    /// The values of the pixels of up to eight tiles, followed by zeros for their rings.
    fn gathered(&self, tiles: &[usize], program: &Program, values: &[f64]) -> Vec<Eight> {
        let width = self.plan.width;
        let mut x = vec![[0.0; 8]; program.order.len() + program.ring.len()];
        for (lane, &tile) in tiles.iter().enumerate() {
            let tile = &self.plan.tiles[tile];
            for (x, &(u, v)) in x.iter_mut().zip(&program.order) {
                x[lane] = values[(tile.top + v) * width + tile.left + u];
            }
        }
        x
    }

    fn scatter(&self, swept: &[Vec<Eight>], values: &mut [f64]) {
        let (plan, width) = (&*self.plan, self.plan.width);
        for (batch, x) in plan.batches.iter().zip(swept) {
            let program = &plan.programs[batch.program];
            for (lane, &tile) in batch.tiles.iter().enumerate() {
                let tile = &plan.tiles[tile];
                for (x, &(u, v)) in x.iter().zip(&program.order) {
                    values[(tile.top + v) * width + tile.left + u] = x[lane];
                }
            }
        }
    }

    /// The values of the pixels of lines, in the order of these.
    fn packed(&self, values: &[f64]) -> Vec<f64> {
        let pixels = self.plan.lines.iter().flat_map(|line| &line.own);
        pixels.map(|&pixel| values[pixel as usize]).collect()
    }

    fn unpack(&self, packed: &[f64], values: &mut [f64]) {
        let pixels = self.plan.lines.iter().flat_map(|line| &line.own);
        for (&pixel, value) in pixels.zip(packed) {
            values[pixel as usize] = *value;
        }
    }

    /// Substitutes forward up to a line, and returns what that adds to the variables that it keeps. `packed`
    /// holds the values of its lines from `base` on.
    fn climb(&self, at: usize, packed: &mut [f64], base: usize, swept: &[Vec<Eight>]) -> Vec<f64> {
        let plan = &*self.plan;
        let line = &plan.lines[at];
        let (below, own) = packed.split_at_mut(line.first - base);
        let mut values = vec![0.0; line.rows];
        values[..line.own.len()].copy_from_slice(&own[..line.own.len()]);
        let added = if let [Half::Line(one), Half::Line(two)] = line.halves {
            let split = plan.lines[one].first + plan.lines[one].own.len() - base;
            let (first, second) = below.split_at_mut(split);
            let (one, two) = both(
                line.tiles > FORK,
                || self.climb(one, first, base, swept),
                || self.climb(two, second, base + split, swept),
            );
            [one, two]
        } else {
            line.halves.map(|half| match half {
                Half::Line(half) => self.climb(half, below, base, swept),
                Half::Tile(tile) => {
                    let tile = &plan.tiles[tile];
                    let program = &plan.programs[plan.batches[tile.batch].program];
                    let ring = &swept[tile.batch][program.order.len()..];
                    ring.iter().map(|value| value[tile.lane]).collect()
                }
            })
        };
        for (added, places) in added.iter().zip(&line.places) {
            for (value, place) in added.iter().zip(places) {
                if let Some(place) = place {
                    values[*place as usize] += value;
                }
            }
        }
        let columns = self.columns(line).chunks_exact(line.rows);
        self.level.vectorised(
            #[inline(always)]
            || {
                for (j, column) in columns.enumerate() {
                    let value = values[j] / column[j];
                    values[j] = value;
                    let later = values[j + 1..].iter_mut().zip(&column[j + 1..]);
                    later.for_each(|(other, factor)| *other -= factor * value);
                }
            },
        );
        own[..line.own.len()].copy_from_slice(&values[..line.own.len()]);
        values.drain(..line.own.len());
        values.truncate(line.kept.len());
        values
    }

    /// Substitutes backward from a line down; `known` are the values that it keeps.
    fn descend(&self, at: usize, packed: &mut [f64], base: usize, known: &[f64]) {
        let plan = &*self.plan;
        let line = &plan.lines[at];
        let (below, own) = packed.split_at_mut(line.first - base);
        let own = &mut own[..line.own.len()];
        let mut values = vec![0.0; line.rows];
        values[..own.len()].copy_from_slice(own);
        values[own.len()..][..known.len()].copy_from_slice(known);
        let columns = self.columns(line);
        self.level.vectorised(
            #[inline(always)]
            || {
                for j in (0..line.own.len()).rev() {
                    let column = &columns[j * line.rows..][..line.rows];
                    let rest = dot(&column[j + 1..], &values[j + 1..]);
                    values[j] = (values[j] - rest) / column[j];
                }
            },
        );
        own.copy_from_slice(&values[..own.len()]);
        let known = |half: usize| kept(line, half, &values);
        if let [Half::Line(one), Half::Line(two)] = line.halves {
            let split = plan.lines[one].first + plan.lines[one].own.len() - base;
            let (first, second) = below.split_at_mut(split);
            let known = [known(0), known(1)];
            both(
                line.tiles > FORK,
                || self.descend(one, first, base, &known[0]),
                || self.descend(two, second, base + split, &known[1]),
            );
        } else {
            for (i, half) in line.halves.into_iter().enumerate() {
                if let Half::Line(half) = half {
                    self.descend(half, below, base, &known(i));
                }
            }
        }
    }
}

/// The values that a half of a line keeps, from those of its front.
fn kept(line: &Line, half: usize, values: &[f64]) -> Vec<f64> {
    let places = line.places[half].iter();
    places
        .map(|place| place.map_or(0.0, |place| values[place as usize]))
        .collect()
}

impl Program {
    /// `x` are the values of the tile's pixels and what is added to its ring.
    #[inline(always)]
    pub(super) fn forward(&self, factor: &[Eight], x: &mut [Eight]) {
        for step in &self.steps {
            for j in 0..step.count {
                let column = step.column(factor, j);
                let mut value = x[step.first + j];
                value.iter_mut().zip(&column[j]).for_each(|(v, c)| *v /= c);
                x[step.first + j] = value;
                for (i, factor) in column.iter().enumerate().take(step.count).skip(j + 1) {
                    subtract(&mut x[step.first + i], factor, &value);
                }
                for (&i, factor) in step.kept.iter().zip(&column[step.count..]) {
                    subtract(&mut x[i as usize], factor, &value);
                }
            }
        }
    }

    /// `x` are the values of the tile's pixels and those of its ring.
    #[inline(always)]
    fn backward(&self, factor: &[Eight], x: &mut [Eight]) {
        for step in self.steps.iter().rev() {
            for j in (0..step.count).rev() {
                let column = step.column(factor, j);
                let mut value = x[step.first + j];
                for (i, factor) in column.iter().enumerate().take(step.count).skip(j + 1) {
                    subtract(&mut value, factor, &x[step.first + i]);
                }
                for (&i, factor) in step.kept.iter().zip(&column[step.count..]) {
                    subtract(&mut value, factor, &x[i as usize]);
                }
                value.iter_mut().zip(&column[j]).for_each(|(v, c)| *v /= c);
                x[step.first + j] = value;
            }
        }
    }
}

impl Step {
    #[inline(always)]
    fn column<'a>(&self, factor: &'a [Eight], j: usize) -> &'a [Eight] {
        &factor[self.start + j * self.rows..][..self.rows]
    }
}

#[inline(always)]
fn subtract(value: &mut Eight, factor: &Eight, other: &Eight) {
    for i in 0..8 {
        value[i] -= factor[i] * other[i];
    }
}

/// Summed in eight lanes, which vector units can do.
#[inline(always)]
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut lanes = [0.0; 8];
    let (whole, rest) = (a.chunks_exact(8), b.chunks_exact(8));
    let ends = whole.remainder().iter().zip(rest.remainder());
    let end: f64 = ends.map(|(a, b)| a * b).sum();
    for (a, b) in whole.zip(rest) {
        for i in 0..8 {
            lanes[i] += a[i] * b[i];
        }
    }
    lanes.iter().sum::<f64>() + end
}
