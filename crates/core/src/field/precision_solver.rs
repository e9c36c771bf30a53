//! A field with its observations in the equations, for any number of observations.
//!
//! With K the equations without observations, S the interpolation at the observations, A their weights and t their targets, the
//! minimum of `y' K y + (S y - t)' A (S y - t)` is `y = H^-1 S' A t` with `H = K + S' A S`. An observation only couples pixels
//! that are already neighbours, so H has a factor like that of K.
//!
//! A lumped observation is treated as one observation of each pixel from which it is interpolated, weighted by the shares s:
//! `sum over q of a s_q (y_q - t)^2` instead of `a (s . y - t)^2`, as masses are lumped in finite elements. If all observations
//! are lumped, every pixel of y is a weighted mean of targets (H is an M-matrix, whose inverse is not negative).

use super::factor::Factor;
use super::grid::Grid;
use super::plan::Plan;
use super::stencil::{Connectivity, Stencil};
use super::sweep::Row;
use crate::bilinear::InterpolationWeights;
use crate::lazy::get_or_compute;
use faer::{Mat, MatRef};
use std::sync::OnceLock;

/// A field with any number of observations, which are part of its equations.
#[derive(Debug)]
pub struct PrecisionSolver {
    factor: Factor,
    interpolation: Vec<InterpolationWeights>,
    weights: Vec<f64>,
    /// The inverse of the equations at neighbouring pixels, computed on first use.
    inverse: OnceLock<Box<Stencil>>,
}

impl PrecisionSolver {
    /// Factorises the equations with observations of these `weights`, each above 0, at positions given by `interpolation`.
    /// `None` if there is no observation, or if the equations are not positive definite in floating point.
    ///
    /// # Panics
    /// If lengths do not match or a pixel is outside the grid.
    pub fn new(
        grid: &Grid<'_>,
        interpolation: &[InterpolationWeights],
        weights: &[f64],
    ) -> Option<Self> {
        Self::with_lumped(grid, interpolation, weights, |_| false)
    }

    /// Like [`Self::new`]; observations for whose index `lumped` is true are lumped.
    ///
    /// # Panics
    /// As for [`Self::new`].
    pub fn with_lumped(
        grid: &Grid<'_>,
        interpolation: &[InterpolationWeights],
        weights: &[f64],
        lumped: impl Fn(usize) -> bool,
    ) -> Option<Self> {
        grid.check();
        assert_eq!(interpolation.len(), weights.len(), "weights");
        if interpolation.is_empty() {
            return None;
        }
        let mut equations = Stencil::new(grid);
        let mut on_pixels = true;
        for (i, (interpolation, &weight)) in interpolation.iter().zip(weights).enumerate() {
            if lumped(i) {
                equations.observe_lumped(interpolation, weight);
            } else {
                equations.observe(interpolation, weight);
                on_pixels &= interpolation.single().is_some();
            }
        }
        let neighbours = if on_pixels {
            Connectivity::Four
        } else {
            Connectivity::Eight
        };
        let plan = Plan::of(grid.height, grid.width, neighbours);
        Some(Self {
            factor: Factor::new(plan, &equations)?,
            interpolation: interpolation.to_vec(),
            weights: weights.to_vec(),
            inverse: OnceLock::new(),
        })
    }

    /// The field `[pixels]` for targets: one for each observation.
    ///
    /// # Panics
    /// If lengths do not match.
    pub fn extend(&self, targets: &[f64]) -> Vec<f64> {
        let zeros = vec![[0.0]; self.factor.plan.len()];
        self.extend_with(targets.as_chunks::<1>().0, zeros)
            .into_flattened()
    }

    /// The fields `[pixels, B]` for a few lists of targets `[observations, B]` and further right-hand sides at every pixel.
    ///
    /// # Panics
    /// If lengths do not match.
    pub fn extend_with<const B: usize>(
        &self,
        targets: &[Row<B>],
        right_sides: Vec<Row<B>>,
    ) -> Vec<Row<B>> {
        assert_eq!(targets.len(), self.interpolation.len(), "targets");
        let mut values = right_sides;
        for ((interpolation, weight), target) in
            self.interpolation.iter().zip(&self.weights).zip(targets)
        {
            for (pixel, share) in interpolation.iter() {
                let sums = values[pixel as usize].iter_mut().zip(target);
                sums.for_each(|(sum, target)| *sum += weight * share * target);
            }
        }
        self.factor.forward(&mut values);
        self.factor.backward(&mut values);
        values
    }

    /// `H^-1 right`, for a right-hand side at every pixel.
    ///
    /// # Panics
    /// If lengths do not match.
    pub fn solve(&self, right: &[f64]) -> Vec<f64> {
        let mut values = right.to_vec();
        let rows = values.as_chunks_mut::<1>().0;
        self.factor.forward(rows);
        self.factor.backward(rows);
        values
    }

    /// `C^-1 targets`, where C is the covariance of the targets: for them, the minimum of the sum over y is
    /// `targets' C^-1 targets`. `field` is the one for these targets.
    ///
    /// # Panics
    /// If lengths do not match.
    pub fn pull_from(&self, targets: &[f64], field: &[f64]) -> Vec<f64> {
        let residual =
            |((interpolation, weight), target): ((&InterpolationWeights, &f64), &f64)| {
                weight * (target - interpolation.read(field))
            };
        let observations = self.interpolation.iter().zip(&self.weights);
        observations.zip(targets).map(residual).collect()
    }

    /// `columns' C^-1 columns`, for columns `[observations, count]`, row by row.
    ///
    /// # Panics
    /// If lengths do not match.
    pub fn moments(&self, columns: &[f64], count: usize) -> Mat<f64> {
        /// Number of columns processed together.
        const B: usize = 4;
        let n = self.interpolation.len();
        let columns = MatRef::from_row_major_slice(columns, n, count);
        let mut pulls = Mat::zeros(n, count);
        for first in (0..count).step_by(B) {
            let own = |i: usize, b: usize| {
                if first + b < count {
                    columns[(i, first + b)]
                } else {
                    0.0
                }
            };
            let targets: Vec<Row<B>> = (0..n).map(|i| std::array::from_fn(|b| own(i, b))).collect();
            let fields = self.extend_with(&targets, vec![[0.0; B]; self.factor.plan.len()]);
            for (i, (interpolation, weight)) in
                self.interpolation.iter().zip(&self.weights).enumerate()
            {
                for b in 0..B.min(count - first) {
                    let read = interpolation
                        .iter()
                        .map(|(pixel, share)| share * fields[pixel as usize][b]);
                    pulls[(i, first + b)] = weight * (targets[i][b] - read.sum::<f64>());
                }
            }
        }
        columns.transpose() * pulls
    }

    /// The variance of the field at each observation, given the targets: `s' H^-1 s`.
    pub fn variances(&self) -> Vec<f64> {
        let inverse = self.inverse();
        self.interpolation
            .iter()
            .map(|interpolation| inverse.at(interpolation))
            .collect()
    }

    /// The variance of the field at the position given by `interpolation`, given the targets.
    pub fn variance(&self, interpolation: &InterpolationWeights) -> f64 {
        self.inverse().at(interpolation)
    }

    /// The variance of the field at each pixel: the diagonal of `H^-1`.
    pub fn pixel_variances(&self) -> Vec<f64> {
        self.inverse().diagonal()
    }

    fn inverse(&self) -> &Stencil {
        get_or_compute(&self.inverse, || Box::new(self.factor.inverse())).as_ref()
    }
}
