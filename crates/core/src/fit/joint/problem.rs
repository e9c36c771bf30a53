//! One joint problem in f64: solution and adjoint.

use super::JointConfig;
use crate::bilinear::InterpolationWeights;
use crate::field::{self, CovarianceSolver, FieldPrior, Grid, PrecisionSolver};
use crate::fit::lstsq::dot;
use faer::linalg::solvers::{Llt, Solve as _};
use faer::{Mat, Side};

/// The data needed for the backward pass.
#[derive(Debug)]
pub struct Adjoint {
    /// The index of each point among the candidates.
    pub rows: Vec<usize>,
    /// The number of candidates.
    pub candidates: usize,
    pixels: Vec<u32>,
    /// Basis functions and depth of each point.
    values: Vec<f64>,
    observation_precision: f64,
    normal: Llt<f64>,
    field: FieldSolver,
    weights: Vec<f64>,
    smooth: Vec<f64>,
}

/// The gradients of one problem.
pub struct Gradients {
    /// Gradient of the basis functions, `[points, k]`.
    pub bases: Vec<f64>,
    /// Gradient of the affinities, `[height, width, 2]`.
    pub affinities: Vec<f64>,
}

/// The field of a few or many points.
#[derive(Debug)]
enum FieldSolver {
    Few(CovarianceSolver),
    Many(PrecisionSolver),
}

impl FieldSolver {
    fn new(
        (grid, prior): (&Grid<'_>, Option<&FieldPrior>),
        interpolation: &[InterpolationWeights],
        weights: &[f64],
        columns: &[f64],
    ) -> Option<Self> {
        if let Some(prior) = prior.filter(|_| interpolation.len() <= field::MOST) {
            return CovarianceSolver::new(prior, interpolation, weights, columns).map(Self::Few);
        }
        PrecisionSolver::new(grid, interpolation, weights).map(Self::Many)
    }

    fn moments(&self, columns: &[f64], count: usize) -> Mat<f64> {
        match self {
            Self::Few(field) => field.moments().clone(),
            Self::Many(field) => field.moments(columns, count),
        }
    }

    /// The field for targets `columns x`.
    fn extend(&self, columns: &[f64], x: &[f64]) -> Vec<f64> {
        match self {
            Self::Few(field) => field.extend(x),
            Self::Many(field) => {
                let rows = columns.chunks_exact(x.len());
                field.extend(&rows.map(|row| dot(row, x)).collect::<Vec<_>>())
            }
        }
    }

    fn solve(&self, right: &[f64]) -> Vec<f64> {
        match self {
            Self::Few(field) => field.solve(right),
            Self::Many(field) => field.solve(right),
        }
    }
}

impl Adjoint {
    /// Solves the problem for the points at `rows` of the candidates. `values` holds basis functions and
    /// depth of each of these points. `prior` is the field of the grid before any observation, if there is one.
    /// The weights of the first `free` basis functions are not penalised.
    pub fn solve(
        (grid, prior): (Grid<'_>, Option<&FieldPrior>),
        (rows, candidates): (Vec<usize>, usize),
        pixels: Vec<u32>,
        values: Vec<f64>,
        config: JointConfig,
        free: usize,
    ) -> Option<Self> {
        let interpolation: Vec<InterpolationWeights> = pixels
            .iter()
            .map(|&pixel| InterpolationWeights::pixel(pixel))
            .collect();
        let precisions = vec![config.observation_precision; pixels.len()];
        let field = FieldSolver::new((&grid, prior), &interpolation, &precisions, &values)?;
        let moments = field.moments(&values, values.len() / pixels.len().max(1));
        let k = moments.ncols() - 1;
        let mut normal = moments.get(..k, ..k).to_owned();
        for i in free..k {
            normal[(i, i)] += config.ridge;
        }
        let normal = normal.llt(Side::Lower).ok()?;
        let right = Mat::from_fn(k, 1, |i, _| moments[(k, i)]);
        let weights = normal.solve(right).col_as_slice(0).to_vec();
        let mut rest: Vec<f64> = weights.iter().map(|w| -w).collect();
        rest.push(1.0);
        let smooth = field.extend(&values, &rest);
        Some(Self {
            rows,
            candidates,
            pixels,
            values,
            observation_precision: config.observation_precision,
            normal,
            field,
            weights,
            smooth,
        })
    }

    /// The weights, followed by the field.
    pub fn solution(&self) -> Vec<f64> {
        [&self.weights[..], &self.smooth].concat()
    }

    /// The gradients from the gradient `grad` of weights and field. Let K be the matrix of the equations of
    /// both, and let (y', w') solve K (y', w') = `grad`. Then the gradient of a parameter is minus (y', w')
    /// times the derivative of those equations with respect to it.
    pub fn backward(&self, grad: &[f64], width: usize) -> Gradients {
        let k = self.weights.len();
        let (grad_weights, grad_field) = grad.split_at(k);
        let mut smooth = self.field.solve(grad_field);
        let mut right = Mat::from_fn(k, 1, |i, _| grad_weights[i]);
        for (row, &pixel) in self.values.chunks_exact(k + 1).zip(&self.pixels) {
            let pull = self.observation_precision * smooth[pixel as usize];
            for (i, value) in row[..k].iter().enumerate() {
                right[(i, 0)] -= pull * value;
            }
        }
        let weights = self.normal.solve(right).col_as_slice(0).to_vec();
        let mut along = weights.clone();
        along.push(0.0);
        let response = self.field.extend(&self.values, &along);
        smooth.iter_mut().zip(&response).for_each(|(s, r)| *s -= r);

        let mut bases = Vec::with_capacity(self.pixels.len() * k);
        for (row, &pixel) in self.values.chunks_exact(k + 1).zip(&self.pixels) {
            let at = pixel as usize;
            let rest = dot(row, &self.weights) + self.smooth[at] - row[k];
            let adjoint = dot(row, &weights) + smooth[at];
            let pairs = weights.iter().zip(&self.weights);
            bases
                .extend(pairs.map(|(v, w)| -self.observation_precision * (rest * v + adjoint * w)));
        }
        let mut affinities = vec![0.0; 2 * smooth.len()];
        for (i, pair) in affinities.chunks_exact_mut(2).enumerate() {
            let slope = |j: usize| -(self.smooth[i] - self.smooth[j]) * (smooth[i] - smooth[j]);
            if (i + 1) % width > 0 {
                pair[0] = slope(i + 1);
            }
            if i + width < smooth.len() {
                pair[1] = slope(i + width);
            }
        }
        Gradients { bases, affinities }
    }
}
