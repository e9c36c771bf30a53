//! How certain a field is: diagonal blocks of the inverse of its equations, from the last front
//! back to the first (Takahashi, Fagan and Chin 1973).

use super::front::Front;
use super::{FORK, Field};
use faer::linalg::triangular_solve::{
    solve_lower_triangular_in_place, solve_upper_triangular_in_place,
};
use faer::{Mat, MatRef, Par};

/// Of which pixels something is asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reach {
    /// Those with a point, at least.
    Points,
    /// All.
    All,
}

/// Some pixels of a field.
#[derive(Clone, Debug)]
pub struct Spread {
    /// Which, `y * width + x`.
    pub pixels: Vec<u32>,
    /// The variance of the field at each, given the targets: the diagonal of the inverse of the
    /// equations.
    pub variances: Vec<f64>,
    /// What the field is for each combination of the columns as targets, `[pixels, combinations]`.
    pub responses: Mat<f64>,
}

/// What is known of pixels that are eliminated later.
struct Known {
    covariance: Mat<f64>,
    responses: Mat<f64>,
}

impl Field {
    /// Variances, and responses to combinations `[columns, combinations]`. Pixels come in any
    /// order, each once.
    pub fn spreads(&self, combinations: MatRef<'_, f64>, reach: Reach) -> Vec<Spread> {
        let Some(last) = self.fronts.len().checked_sub(1) else {
            return Vec::new();
        };
        let known = Known {
            covariance: Mat::zeros(0, 0),
            responses: Mat::zeros(0, combinations.ncols()),
        };
        self.descend(last, &known, combinations, reach)
    }

    fn descend(
        &self,
        at: usize,
        later: &Known,
        combinations: MatRef<'_, f64>,
        reach: Reach,
    ) -> Vec<Spread> {
        let front = &self.fronts[at];
        let halves: Vec<usize> = front.halves(at, &self.fronts);
        let wanted = |&half: &usize| reach == Reach::All || self.fronts[half].joined;
        let halves: Vec<usize> = halves.into_iter().filter(wanted).collect();
        let (known, spread) = front.inverse(later, combinations);
        let run = |half: usize| {
            let part = known.part(&self.fronts[half].inherited);
            self.descend(half, &part, combinations, reach)
        };
        let mut spreads = match halves[..] {
            [one, two] if front.descendants > FORK => {
                let (mut one, two) = rayon::join(|| run(one), || run(two));
                one.extend(two);
                one
            }
            _ => halves.into_iter().flat_map(run).collect(),
        };
        spreads.push(spread);
        spreads
    }
}

impl Known {
    /// Of some of the pixels.
    fn part(&self, places: &[u32]) -> Self {
        let at = |i: usize| places[i] as usize;
        let count = places.len();
        Self {
            covariance: Mat::from_fn(count, count, |i, j| self.covariance[(at(i), at(j))]),
            responses: Mat::from_fn(count, self.responses.ncols(), |i, j| {
                self.responses[(at(i), j)]
            }),
        }
    }
}

impl Front {
    /// Covariances and responses of the pixels of the front, those it eliminates first.
    fn inverse(&self, later: &Known, combinations: MatRef<'_, f64>) -> (Known, Spread) {
        let count = self.eliminated.len();
        let kept = later.covariance.nrows();
        let own = self.factor.matrix(0..count, count);
        // With L_e the triangle of the eliminated and L_k the rows of the kept pixels: L_e^-T L_k^T.
        let mut across = self
            .factor
            .matrix(count..count + kept, count)
            .transpose()
            .to_owned();
        solve_upper_triangular_in_place(own.as_ref().transpose(), across.as_mut(), Par::Seq);
        let columns = self
            .factor
            .matrix(count + kept..self.factor.length(), count);
        let mut responses = Mat::<f64>::zeros(count, combinations.ncols());
        if columns.nrows() > 0 {
            responses = columns.transpose() * combinations * faer::Scale(-1.0);
            solve_upper_triangular_in_place(own.as_ref().transpose(), responses.as_mut(), Par::Seq);
        }
        responses -= &across * &later.responses;

        let mut inverse = Mat::<f64>::identity(count, count);
        solve_lower_triangular_in_place(own.as_ref(), inverse.as_mut(), Par::Seq);
        let shared = &across * &later.covariance;
        let square = inverse.transpose() * &inverse + &shared * across.transpose();
        let size = count + kept;
        let covariance = Mat::from_fn(size, size, |i, j| match (i < count, j < count) {
            (true, true) => square[(i, j)],
            (true, false) => -shared[(i, j - count)],
            (false, true) => -shared[(j, i - count)],
            (false, false) => later.covariance[(i - count, j - count)],
        });
        let known = Known {
            covariance,
            responses: Mat::from_fn(size, combinations.ncols(), |i, j| {
                if i < count {
                    responses[(i, j)]
                } else {
                    later.responses[(i - count, j)]
                }
            }),
        };
        let spread = Spread {
            pixels: self.eliminated.clone(),
            variances: (0..count).map(|i| square[(i, i)]).collect(),
            responses,
        };
        (known, spread)
    }
}
