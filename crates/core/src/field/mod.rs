//! A smooth field on a pixel grid, observed at some positions: the minimum of
//!
//! > sum over neighbours c_ij (y_i - y_j)^2 + level sum over pixels y_i^2
//! > + sum over observations a_p (s_p . y - t_p)^2
//!
//! for targets t that are linear combinations of given columns; s_p interpolates the field bilinearly between
//! the pixels around a position.
//!
//! It is solved directly, by Cholesky factorisation in the order of nested dissection (George 1973). With up to
//! [`MOST`] observations, the factor is that of the equations without them ([`FieldPrior`]), which depends on the
//! image alone, and observations are added in the form of covariances (`kriged`); with more, or without
//! `level`, the equations are factorised with all of them (`direct`).

mod border;
mod direct;
mod factor;
mod kriged;
mod plan;
mod runs;
mod stencil;
mod sweep;
#[cfg(test)]
mod tests;
mod tile;

use crate::bilinear::Taps;
use direct::Direct;
use factor::Factor;
use faer::{Mat, MatRef};
use kriged::Kriged;
use plan::Plan;
use std::sync::Arc;
use stencil::Stencil;

/// The affinities of neighbouring pixels, `[height * width]` each, none negative.
#[derive(Clone, Copy, Debug)]
pub struct Grid<'a> {
    /// Number of rows.
    pub height: usize,
    /// Number of columns.
    pub width: usize,
    /// Affinity of each pixel with its right neighbour; the last column is not used.
    pub right: &'a [f64],
    /// Affinity of each pixel with the one below; the last row is not used.
    pub down: &'a [f64],
    /// Strength of the pull of each pixel towards 0; 0 = none.
    pub level: f64,
}

/// The observations of a field.
#[derive(Clone, Copy, Debug)]
pub struct Observations<'a> {
    /// The pixels that each observation is interpolated from.
    pub taps: &'a [Taps],
    /// The weight of each observation, above 0.
    pub weights: &'a [f64],
    /// The columns whose combinations are the targets, `[observations, columns]`, row by row.
    pub columns: &'a [f64],
    /// The number of columns.
    pub count: usize,
}

/// With more observations the form of covariances, whose cost grows with their square, is not the faster one.
pub const MOST: usize = 1000;

/// A field before any observation: the factor of its equations, which every set of observations shares.
#[derive(Clone, Debug)]
pub struct FieldPrior(Arc<Factor>);

impl FieldPrior {
    /// Factorises the equations. `None` if values are not finite, or `level` is next to 0: the field is then free
    /// by a constant until it is observed, whose variance drowns all others in rounding.
    ///
    /// # Panics
    /// If lengths do not match.
    pub fn new(grid: &Grid<'_>) -> Option<Self> {
        const LEAST: f64 = 1e-12;
        grid.check();
        if grid.level.is_nan() || grid.level < LEAST {
            return None;
        }
        let plan = Plan::of(grid.height, grid.width);
        let factor = Factor::new(plan, &Stencil::new(grid));
        factor.map(|factor| Self(Arc::new(factor)))
    }

    /// The covariances of the values at observations before any of them is known, `[observations,
    /// observations]`, noise not included. Columns before the last one may be functions that are part of the
    /// field, with a penalty on the square of the weight of each: its ridge.
    ///
    /// # Panics
    /// If lengths do not match or a pixel is outside the grid.
    pub fn covariance(&self, seen: &Observations<'_>, ridges: &[f64]) -> Mat<f64> {
        seen.check();
        assert!(ridges.len() < seen.count, "columns");
        kriged::covariance(&self.0, seen, ridges)
    }
}

/// A factorised field: solving for any combination of the columns costs almost nothing.
#[derive(Debug)]
pub struct Field(Form);

#[derive(Debug)]
enum Form {
    Kriged(Kriged),
    Direct(Direct),
}

impl Field {
    /// Factorises the equations. Returns `None` if values are not finite, a weight is not above 0, or there
    /// is no observation.
    ///
    /// # Panics
    /// If lengths do not match or a pixel is outside the grid.
    pub fn new(grid: &Grid<'_>, seen: &Observations<'_>) -> Option<Self> {
        grid.check();
        seen.check();
        if seen.taps.is_empty() {
            return None;
        }
        let direct = Direct::new(grid, seen)?;
        Some(Self(Form::Direct(direct)))
    }

    /// The same, from the equations without observations. Columns before the last one may be functions that are
    /// part of the field, with a penalty on the square of the weight of each: its ridge.
    ///
    /// # Panics
    /// If lengths do not match or a pixel is outside the grid.
    pub fn with_prior(prior: &FieldPrior, seen: &Observations<'_>, ridges: &[f64]) -> Option<Self> {
        seen.check();
        assert!(ridges.len() < seen.count, "columns");
        if seen.taps.is_empty() {
            return None;
        }
        let kriged = Kriged::new(prior.0.clone(), seen, ridges)?;
        Some(Self(Form::Kriged(kriged)))
    }

    /// `columns^T C columns` (lower half) for the columns that are not part of the field, where C is the inverse covariance of the targets: for targets
    /// `columns x`, the minimum of the sum above over y is `x^T moments x`.
    pub fn moments(&self) -> &Mat<f64> {
        match &self.0 {
            Form::Kriged(field) => field.moments(),
            Form::Direct(field) => field.moments(),
        }
    }

    /// The number of columns that are part of the field.
    pub fn functions(&self) -> usize {
        match &self.0 {
            Form::Kriged(field) => field.functions(),
            Form::Direct(_) => 0,
        }
    }

    /// The field for targets `columns x`, less the functions that are part of it, and the weights of these.
    pub fn extend(&self, x: &[f64]) -> (Vec<f64>, Vec<f64>) {
        match &self.0 {
            Form::Kriged(field) => field.extend(x),
            Form::Direct(field) => (field.extend(x), Vec::new()),
        }
    }

    /// The solution of the equations for y, for a right-hand side at every pixel.
    pub fn solve(&self, right: &[f64]) -> Vec<f64> {
        match &self.0 {
            Form::Kriged(field) => field.solve(right),
            Form::Direct(field) => field.solve(right),
        }
    }

    /// Whether [`Self::spreads`] has an answer.
    pub fn reaches(&self, reach: Reach) -> bool {
        matches!(self.0, Form::Direct(_)) || reach == Reach::Observations
    }

    /// Variances, and responses to combinations `[columns, combinations]`. Positions come in any order, each
    /// once. `columns` are those of the observations. `None` at the pixels of a field with a prior.
    pub fn spreads(
        &self,
        columns: &[f64],
        combinations: MatRef<'_, f64>,
        reach: Reach,
    ) -> Option<Vec<Spread>> {
        match (&self.0, reach) {
            (Form::Direct(field), _) => Some(field.spreads(columns, combinations, reach)),
            (Form::Kriged(field), Reach::Observations) => Some(vec![field.spread(combinations)]),
            (Form::Kriged(_), Reach::Pixels) => None,
        }
    }
}

impl Grid<'_> {
    fn check(&self) {
        let pixels = self.height * self.width;
        assert_eq!([self.right.len(), self.down.len()], [pixels; 2], "grid");
    }
}

impl Observations<'_> {
    fn check(&self) {
        assert_eq!(self.weights.len(), self.taps.len(), "weights");
        assert_eq!(self.columns.len(), self.taps.len() * self.count, "columns");
    }
}

/// Where variances and responses are computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reach {
    /// At the observations.
    Observations,
    /// At every pixel.
    Pixels,
}

/// Variances and responses of a field at some positions.
#[derive(Clone, Debug)]
pub struct Spread {
    /// The positions: pixels `y * width + x`, or indices of observations in the order in which they were
    /// given.
    pub places: Vec<u32>,
    /// The variance of the field at each position, given the targets: for pixels, the diagonal of the inverse
    /// of the equations.
    pub variances: Vec<f64>,
    /// The value of the field at each position, with each combination of the columns as targets,
    /// `[places, combinations]`.
    pub responses: Mat<f64>,
}
