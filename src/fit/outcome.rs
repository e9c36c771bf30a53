//! What a fit found, and what follows from it in closed form.

use super::points::Rows;
use super::robust::deviation;
use super::{Estimate, Smooth, Solution, Space};
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatRef, Par};

/// The outcome of a fit.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// Weights of the base functions, the constant first, in metres (in the unit of the space).
    pub weights: Vec<f64>,
    /// Depth minus fitted depth at each point, in metres.
    pub residuals: Vec<f64>,
    /// The weight of each point in the last solve: all 1 for a plain fit.
    pub point_weights: Vec<f64>,
    /// The number of directions that the points determine, at most N + 1.
    pub rank: usize,
    /// How strongly the weights were drawn towards a prior, if there was one: the variance of the
    /// noise over that of the prior.
    pub lambda: Option<f64>,
    /// What base functions add up to.
    pub space: Space,
    /// The field that base functions x weights are added to, if there is one.
    pub smooth: Option<Smooth>,
    /// The variance of a point of weight 1 about the fit, in the squared unit of the space.
    pub(super) noise: f64,
    /// Depths, and residuals, in the space of the fit.
    values: Vec<f64>,
    pub(super) rests: Vec<f64>,
    solution: Solution,
}

impl Fit {
    pub(super) fn new(
        rows: &Rows<'_>,
        estimate: Estimate,
        point_weights: Vec<f64>,
        space: Space,
    ) -> Self {
        let Estimate {
            solution,
            noise,
            lambda,
        } = estimate;
        let rests = rows.residuals(&solution.weights);
        Self {
            weights: solution.weights.clone(),
            residuals: metres(&rows.values, &rests, space),
            point_weights,
            rank: solution.rank,
            lambda,
            space,
            smooth: None,
            noise,
            values: rows.values.clone(),
            rests,
            solution,
        }
    }

    /// With a field, which has these values at the points.
    pub(super) fn with_field(self, smooth: Smooth, at_points: &[f64]) -> Self {
        let pairs = self.rests.iter().zip(at_points);
        let rests: Vec<f64> = pairs.map(|(rest, value)| rest - value).collect();
        Self {
            residuals: metres(&self.values, &rests, self.space),
            rests,
            smooth: Some(smooth),
            ..self
        }
    }

    /// Root mean square of the residuals, in metres.
    pub fn rms(&self) -> f64 {
        root_mean_square(&self.residuals)
    }

    /// How much of its own depth the fitted depth at each point is, from 0 to 1. `bases` are those
    /// that were fitted.
    pub fn leverages(&self, bases: &[f32]) -> Vec<f64> {
        self.solution.leverages(bases, &self.point_weights)
    }

    /// What the residual of each point would be, in metres, had it been left out of the fit: the
    /// residual over 1 - leverage (Allen 1974). Their root mean square, the PRESS error, says
    /// without a true depth map how far the depth is off between the points, where these are spread
    /// as the pixels are.
    pub fn left_out(&self, leverages: &[f64]) -> Vec<f64> {
        metres(
            &self.values,
            &without_own(&self.rests, leverages),
            self.space,
        )
    }

    /// How many robust standard deviations each point lies off what the others say (the modified
    /// score of Iglewicz and Hoaglin 1993): positive where it is farther.
    pub fn scores(&self, leverages: &[f64]) -> Vec<f64> {
        let off = without_own(&self.rests, leverages);
        let deviation = deviation(&off).max(f64::MIN_POSITIVE);
        // Inverses fall as depths grow.
        let sign = if self.space == Space::Inverse {
            -1.0
        } else {
            1.0
        };
        off.iter().map(|r| sign * r / deviation).collect()
    }

    /// The variance of the fitted value for each row of base functions, for points whose noise has
    /// variance 1. In f32: there is one row for each pixel.
    pub fn spreads(&self, bases: &[f32]) -> Vec<f32> {
        let k = self.weights.len().max(1);
        let factor = &self.solution.factor;
        let factor = Mat::from_fn(k, factor.ncols(), |i, j| factor[(i, j)] as f32);
        // Transposed, so that the values of a pixel lie together.
        let mut product = Mat::<f32>::zeros(factor.ncols(), bases.len() / k);
        let rows = MatRef::from_row_major_slice(bases, bases.len() / k, k);
        let (accum, par) = (Accum::Replace, Par::Seq);
        matmul(
            product.as_mut(),
            accum,
            factor.transpose(),
            rows.transpose(),
            1.0,
            par,
        );
        let columns = product.col_iter();
        columns.map(|column| column.squared_norm_l2()).collect()
    }
}

/// Residuals in metres, of values and residuals in the space of a fit.
fn metres(values: &[f64], rests: &[f64], space: Space) -> Vec<f64> {
    let pairs = values.iter().zip(rests);
    let metres = |(&value, &rest): (&f64, &f64)| match space {
        Space::Depth => rest,
        _ => space.depth(value) - space.depth(value - rest),
    };
    pairs.map(metres).collect()
}

/// Residuals over 1 - leverage. A point that a fit meets whatever its depth is says nothing: its
/// residual is 0 over 0, and stays small.
pub(super) fn without_own(residuals: &[f64], leverages: &[f64]) -> Vec<f64> {
    const LEAST_FREEDOM: f64 = 1e-3;
    let pairs = residuals.iter().zip(leverages);
    pairs
        .map(|(r, h)| r / (1.0 - h).max(LEAST_FREEDOM))
        .collect()
}

/// The root of the mean square.
pub fn root_mean_square(values: &[f64]) -> f64 {
    let sum: f64 = values.iter().map(|v| v * v).sum();
    (sum / values.len().max(1) as f64).sqrt()
}
