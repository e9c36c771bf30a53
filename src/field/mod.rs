//! A smooth field on a grid of pixels, observed at some of them: the minimum of
//!
//! > sum over neighbours c_ij (y_i - y_j)^2 + sum over points a_p (y_p - t_p)^2
//!
//! for targets t that are combinations of given columns. Solved directly, by Cholesky factorisation
//! in the order of nested dissection (George 1973): a grid is cut in halves by a line of pixels,
//! the halves are eliminated first, in parallel, and the line last. Points are eliminated where
//! more than a few have gathered, so that the columns meet only the last and largest steps.

mod dissection;
mod front;
#[cfg(test)]
mod tests;

use dissection::{Dissection, Region};
use faer::Mat;
use front::{Front, Parent};

/// How strongly neighbours are joined, `[height * width]` each, none negative.
#[derive(Clone, Copy, Debug)]
pub struct Grid<'a> {
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// Of each pixel and its right neighbour; the last column is not read.
    pub right: &'a [f64],
    /// Of each pixel and the one below; the last row is not read.
    pub down: &'a [f64],
}

/// Where and how a field is observed.
#[derive(Clone, Copy, Debug)]
pub struct Observations<'a> {
    /// The pixel `y * width + x` of each point, no two alike.
    pub pixels: &'a [u32],
    /// How much each counts, above 0.
    pub weights: &'a [f64],
    /// `[points, columns]`, row by row.
    pub columns: &'a [f64],
    /// The number of columns.
    pub count: usize,
}

/// A factorised field: what any combination of the columns gives costs next to nothing.
#[derive(Clone, Debug)]
pub struct Field {
    fronts: Vec<Front>,
    pixels: usize,
    moments: Mat<f64>,
    log_determinant: f64,
}

/// Observations by pixel.
struct Sites<'a> {
    seen: &'a Observations<'a>,
    /// One more than the place of the point at each pixel, or 0.
    places: Vec<u32>,
}

impl Field {
    /// Factorises, or `None` if the numbers are not finite, a weight is not above 0, or there is
    /// no point.
    ///
    /// # Panics
    /// If lengths do not go together or a pixel is outside the grid.
    pub fn new(grid: &Grid<'_>, seen: &Observations<'_>) -> Option<Self> {
        let pixels = grid.height * grid.width;
        assert_eq!([grid.right.len(), grid.down.len()], [pixels; 2], "grid");
        assert_eq!(seen.weights.len(), seen.pixels.len(), "weights");
        assert_eq!(
            seen.columns.len(),
            seen.pixels.len() * seen.count,
            "columns"
        );
        let mut places = vec![0; pixels];
        for (place, &pixel) in seen.pixels.iter().enumerate() {
            places[pixel as usize] = place as u32 + 1;
        }
        let sites = Sites { seen, places };
        let cuts = Dissection::new(grid.height, grid.width);
        let whole = Region::whole(grid.height, grid.width);
        let mut places = vec![0; pixels + seen.count];
        let parent = Parent {
            grid,
            sites: &sites,
            cuts: &cuts,
        };
        let part = parent.eliminate(whole, &mut places)?;
        Some(Self {
            fronts: part.fronts,
            pixels,
            moments: part.rest,
            log_determinant: part.log_determinant,
        })
    }

    /// `columns^T C columns` (lower half), C being the inverse covariance of the targets: what is
    /// left of the sum above at its minimum over y, for targets `columns x`, is `x^T moments x`.
    pub fn moments(&self) -> &Mat<f64> {
        &self.moments
    }

    /// The logarithm of the determinant of the equations of y.
    pub fn log_determinant(&self) -> f64 {
        self.log_determinant
    }

    /// The field for targets `columns x`.
    pub fn extend(&self, x: &[f64]) -> Vec<f64> {
        let mut values = vec![0.0; self.pixels];
        values.extend_from_slice(x);
        self.substitute(&mut values);
        values.truncate(self.pixels);
        values
    }

    /// The answer of the equations of y, for a right-hand side at every pixel.
    pub fn solve(&self, right: &[f64]) -> Vec<f64> {
        let mut values = right.to_vec();
        values.resize(self.pixels + self.moments.ncols(), 0.0);
        for front in &self.fronts {
            front.forward(&mut values);
        }
        values[self.pixels..].fill(0.0);
        self.substitute(&mut values);
        values.truncate(self.pixels);
        values
    }

    fn substitute(&self, values: &mut [f64]) {
        let mut kept = Vec::new();
        for front in self.fronts.iter().rev() {
            front.backward(values, &mut kept);
        }
    }
}
