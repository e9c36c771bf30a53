//! A smooth field on a grid of pixels, observed at some of them: the minimum of
//!
//! > sum over neighbours c_ij (y_i - y_j)^2 + level sum over pixels y_i^2
//! > + sum over points a_p (y_p - t_p)^2
//!
//! for targets t that are combinations of given columns. Solved directly, by Cholesky factorisation
//! in the order of nested dissection (George 1973): a grid is cut in halves by a line of pixels,
//! the halves are eliminated first, in parallel, and the line last. Points are eliminated where
//! more than a few have gathered, so that the columns meet only the last and largest steps.

mod columns;
mod dense;
mod dissection;
mod elimination;
mod front;
mod spread;
#[cfg(test)]
mod tests;

pub use spread::{Reach, Spread};

use crate::simd::Level;
use dissection::{Dissection, Region};
use elimination::{Elimination, Room};
use faer::Mat;
use front::Front;

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
    /// How strongly each pixel is held at 0; 0 = not at all.
    pub level: f64,
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

/// Fronts with more descendants share them among threads.
const FORK: usize = 16;

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
        if seen.pixels.is_empty() {
            return None;
        }
        let sites = Sites { seen, places };
        let cuts = Dissection::new(grid.height, grid.width);
        let whole = Region::whole(grid.height, grid.width);
        let elimination = Elimination {
            grid,
            sites: &sites,
            cuts: &cuts,
            level: Level::here(),
        };
        let part = elimination.eliminate(whole, &mut Room::new(pixels + seen.count))?;
        Some(Self {
            fronts: part.fronts,
            pixels,
            moments: part.rest.matrix(0..seen.count, seen.count),
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
        self.substitute(&vec![0.0; self.pixels], x)
    }

    /// The answer of the equations of y, for a right-hand side at every pixel.
    pub fn solve(&self, right: &[f64]) -> Vec<f64> {
        let columns = self.moments.ncols();
        let mut values = right.to_vec();
        values.resize(self.pixels + columns, 0.0);
        for front in &self.fronts {
            front.forward(&mut values);
        }
        self.substitute(&values, &vec![0.0; columns])
    }

    /// What is left of the equations once they are triangular, from the last front to the first.
    fn substitute(&self, right: &[f64], columns: &[f64]) -> Vec<f64> {
        let mut values = vec![0.0; self.pixels];
        let Some(last) = self.fronts.len().checked_sub(1) else {
            return values;
        };
        for (at, found) in self.descend_values(last, &[], right, columns) {
            let pixels = &self.fronts[at].eliminated;
            for (&pixel, value) in pixels.iter().zip(found) {
                values[pixel as usize] = value;
            }
        }
        values
    }

    /// The values of the variables of a front and its descendants, those that it eliminates first;
    /// `later` are those of the front that it is a half of.
    fn descend_values(
        &self,
        at: usize,
        later: &[f64],
        right: &[f64],
        columns: &[f64],
    ) -> Vec<(usize, Vec<f64>)> {
        let front = &self.fronts[at];
        let mut values = vec![0.0; front.eliminated.len()];
        values.extend(front.inherited.iter().map(|&place| later[place as usize]));
        if front.joined {
            values.extend_from_slice(columns);
        }
        front.backward(right, &mut values);
        let run = |half: usize| self.descend_values(half, &values, right, columns);
        let mut found = match front.halves(at, &self.fronts)[..] {
            [one, two] if front.descendants > FORK => {
                let (mut one, two) = rayon::join(|| run(one), || run(two));
                one.extend(two);
                one
            }
            [one, two] => {
                let mut one = run(one);
                one.extend(run(two));
                one
            }
            _ => Vec::new(),
        };
        found.push((at, values));
        found
    }
}
