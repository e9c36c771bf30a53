//! The variances of a field: diagonal blocks of the inverse of its equations, computed from the last front
//! back to the first (selected inversion: Takahashi, Fagan and Chin 1973).

use super::front::Front;
use super::{Carrier, Direct, FORK, Reach, Spread};
use faer::linalg::triangular_solve::{
    solve_lower_triangular_in_place, solve_upper_triangular_in_place,
};
use faer::{Mat, MatRef, Par};

/// Covariance and responses of the variables that are eliminated later.
struct Known {
    covariance: Mat<f64>,
    responses: Mat<f64>,
}

impl Direct {
    pub(in crate::field) fn spreads(
        &self,
        columns: &[f64],
        combinations: MatRef<'_, f64>,
        reach: Reach,
    ) -> Vec<Spread> {
        let spreads = self.spreads_of_variables(combinations, reach);
        match reach {
            Reach::Pixels => spreads
                .into_iter()
                .map(|part| self.pixels_of(part))
                .collect(),
            Reach::Observations => {
                let mut carried = vec![None; self.variables];
                for (i, carrier) in self.carriers.iter().enumerate() {
                    carried[carrier.variable as usize] = Some(i as u32);
                }
                let observed = |part| self.observations_of(part, &carried, columns, combinations);
                spreads.into_iter().map(observed).collect()
            }
        }
    }

    fn pixels_of(&self, part: Spread) -> Spread {
        if part
            .places
            .iter()
            .all(|&variable| (variable as usize) < self.pixels)
        {
            return part;
        }
        part.chosen(|variable| ((variable as usize) < self.pixels).then_some(variable))
    }

    /// From the variables that carry observations to the field at these. With f the field at a place
    /// between pixels and z its carrier, `2 a (f - z)^2 + 2 a (z - t)^2` makes z the mean of f and the
    /// target t, with a variance of its own of 1 / 4a.
    fn observations_of(
        &self,
        part: Spread,
        carried: &[Option<u32>],
        columns: &[f64],
        combinations: MatRef<'_, f64>,
    ) -> Spread {
        let mut part = part.chosen(|variable| carried[variable as usize]);
        let count = combinations.nrows();
        for (i, &observation) in part.places.iter().enumerate() {
            let Carrier { variable, weight } = self.carriers[observation as usize];
            if (variable as usize) < self.pixels {
                continue;
            }
            part.variances[i] = 4.0 * part.variances[i] - 2.0 / weight;
            let row = &columns[observation as usize * count..][..count];
            for j in 0..combinations.ncols() {
                let pairs = row.iter().enumerate();
                let target: f64 = pairs.map(|(k, value)| value * combinations[(k, j)]).sum();
                part.responses[(i, j)] = 2.0 * part.responses[(i, j)] - target;
            }
        }
        part
    }

    fn spreads_of_variables(&self, combinations: MatRef<'_, f64>, reach: Reach) -> Vec<Spread> {
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
        let wanted = |&half: &usize| reach == Reach::Pixels || self.fronts[half].joined;
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

impl Spread {
    /// Only the places that have another name, under that.
    fn chosen(&self, name: impl Fn(u32) -> Option<u32>) -> Self {
        let pairs = self.places.iter().enumerate();
        let (rows, places): (Vec<usize>, Vec<u32>) = pairs
            .filter_map(|(i, &place)| Some((i, name(place)?)))
            .unzip();
        Self {
            variances: rows.iter().map(|&i| self.variances[i]).collect(),
            responses: Mat::from_fn(rows.len(), self.responses.ncols(), |i, j| {
                self.responses[(rows[i], j)]
            }),
            places,
        }
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
            places: self.eliminated.clone(),
            variances: (0..count).map(|i| square[(i, i)]).collect(),
            responses,
        };
        (known, spread)
    }
}
