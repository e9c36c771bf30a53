//! The directions of the weights that the points determine, for a strength of the prior chosen from the points.

use super::lambda::Lambda;
use super::reduced::{ROUNDING, Reduced, Shrunk};
use crate::error::FitError;
use faer::{Mat, Side};

/// A problem decomposed into independent directions of u, for any lambda.
pub(super) struct Spectrum<'a> {
    reduced: &'a Reduced<'a>,
    /// Squared singular values of `P A L`.
    squares: Vec<f64>,
    /// Their right singular vectors.
    directions: Mat<f64>,
    /// The depths in these directions, times the singular values.
    along: Vec<f64>,
}

impl<'a> Spectrum<'a> {
    pub(super) fn new(reduced: &'a Reduced<'a>) -> Result<Self, FitError> {
        let eigen = reduced
            .normal
            .self_adjoint_eigen(Side::Lower)
            .map_err(|_| FitError::Unsolvable("its eigenvalues did not converge"))?;
        let directions = eigen.U().to_owned();
        let mut squares: Vec<f64> = eigen.S().column_vector().iter().copied().collect();
        let along = directions.col_iter().map(|direction| {
            let pairs = direction.iter().zip(&reduced.rhs);
            pairs.map(|(a, b)| a * b).sum()
        });
        let mut along: Vec<f64> = along.collect();
        // Rounding errors in directions that the points do not determine.
        for (square, along) in squares.iter_mut().zip(&mut along) {
            if *square <= ROUNDING * reduced.trace {
                (*square, *along) = (0.0, 0.0);
            }
        }
        Ok(Self {
            reduced,
            squares,
            directions,
            along,
        })
    }

    /// `|P (d - A L u)|^2 + lambda |u|^2` at its minimum.
    fn penalised(&self, lambda: f64) -> f64 {
        let pairs = self.along.iter().zip(&self.squares);
        let met: f64 = pairs.map(|(c, g)| c * c / (g + lambda)).sum();
        (self.reduced.residual_square - met).max(0.0)
    }

    /// -2 ln p(depths | lambda) - 2 ln p(lambda), up to a constant: scale and noise integrated out
    /// with flat priors but for the one on the amplitude of u.
    pub(super) fn neg_log_likelihood(&self, lambda: f64) -> f64 {
        let volume: f64 = self.squares.iter().map(|g| (1.0 + g / lambda).ln()).sum();
        let noise = &self.reduced.prior.noise;
        let count = self.reduced.freedom + noise.equivalent_points;
        let total = self.penalised(lambda) + self.reduced.expected(lambda);
        let misfit = if total > 0.0 {
            count * (total / self.reduced.square).ln() - noise.equivalent_points * lambda.ln()
        } else {
            0.0
        };
        let known = noise
            .deviation
            .map_or(0.0, |d| ((lambda.ln() - noise.mean) / d).powi(2));
        volume + misfit + known
    }

    /// The mean squared residual over the squared share of freedom that is left.
    fn cross_validation(&self, lambda: f64) -> f64 {
        let triples = self.squares.iter().zip(&self.along);
        let (mut residual, mut freedom) = (self.reduced.residual_square, self.reduced.freedom);
        for (g, c) in triples {
            residual -= c * c * (g + 2.0 * lambda) / (g + lambda).powi(2);
            freedom -= g / (g + lambda);
        }
        residual.max(0.0) / freedom.max(1e-9).powi(2)
    }

    /// The strength that the points choose: by cross-validation, otherwise by evidence.
    pub(super) fn chosen(&self, lambda: Lambda) -> f64 {
        match lambda {
            Lambda::Gcv => self.best(|lambda| self.cross_validation(lambda)),
            _ => self.best(|lambda| self.neg_log_likelihood(lambda)),
        }
    }

    /// The lambda of the least cost: on a grid first, as there may be several minima, then by
    /// golden section.
    fn best(&self, cost: impl Fn(f64) -> f64) -> f64 {
        const STEP: f64 = 0.5;
        const GOLDEN: f64 = 0.618_033_988_749_894_9;
        let expected = self.reduced.prior.noise.mean;
        let largest = self.squares.iter().fold(0.0, |m: f64, &g| m.max(g));
        if largest <= 0.0 || self.reduced.residual_square <= 0.0 {
            return expected.exp();
        }
        let at = |x: f64| cost(x.exp());
        let (low, high) = (largest.ln() - 28.0, largest.ln() + 7.0);
        let steps = ((high - low) / STEP) as usize;
        let grid = (0..=steps).map(|i| low + STEP * i as f64);
        let best = grid.map(|x| (at(x), x)).min_by(|a, b| a.0.total_cmp(&b.0));
        let best = best.map_or(expected, |(_, x)| x);
        let (mut low, mut high) = (best - STEP, best + STEP);
        while high - low > 1e-6 {
            let (a, b) = (high - GOLDEN * (high - low), low + GOLDEN * (high - low));
            if at(a) < at(b) {
                high = b;
            } else {
                low = a;
            }
        }
        f64::midpoint(low, high).exp()
    }

    pub(super) fn shrunk(&self, lambda: f64) -> Shrunk {
        let roots: Vec<f64> = self.squares.iter().map(|g| (g + lambda).sqrt()).collect();
        let mut factor = self.reduced.map() * &self.directions;
        for (column, root) in factor.col_iter_mut().zip(&roots) {
            column.iter_mut().for_each(|value| *value /= root);
        }
        let along: Vec<f64> = self.along.iter().zip(&roots).map(|(c, r)| c / r).collect();
        let determined = self.squares.iter().filter(|g| **g > lambda).count();
        self.reduced.shrunk(lambda, &along, factor, determined)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::{NoisePrior, Prior, Problem};
    use lsdc_rng::Rng;

    /// Random basis functions of some points, and a prior of a lower rank than these.
    fn problem(points: usize) -> (Problem, Prior) {
        const COLUMNS: usize = 23;
        const RANK: usize = 18;
        let mut rng = Rng::stream(0, &["spectrum"]);
        let mut normals = |count: usize| -> Vec<f32> { (0..count).map(|_| rng.normal()).collect() };
        let bases = normals(points * COLUMNS);
        let depths: Vec<f64> = normals(points).iter().map(|v| f64::from(3.0 + v)).collect();
        let noise = NoisePrior {
            mean: -3.0,
            deviation: Some(1.0),
            equivalent_points: 5.0,
        };
        let prior = Prior::new(&normals(COLUMNS), &normals(COLUMNS * RANK), noise).unwrap();
        let problem = Problem::new(&bases, &depths, &vec![1.0; points]);
        (problem, prior)
    }

    #[test]
    fn a_known_strength_needs_no_directions() {
        for points in [1, 7, 18, 60] {
            let (problem, prior) = problem(points);
            let moments = problem.moments();
            let reduced = Reduced::new(&moments, &prior).unwrap();
            let spectrum = Spectrum::new(&reduced).unwrap();
            for lambda in [1e-4, 0.3, 20.0, 1e5] {
                let expected = spectrum.shrunk(lambda);
                let found = moments.shrunk(&prior, Lambda::Fixed(lambda)).unwrap();
                assert_eq!(
                    found.solution.rank, expected.solution.rank,
                    "{points} {lambda}"
                );
                assert!((found.noise / expected.noise - 1.0).abs() < 1e-8);
                let pairs = found
                    .solution
                    .weights
                    .iter()
                    .zip(&expected.solution.weights);
                pairs.for_each(|(a, b)| assert!((a - b).abs() < 1e-8, "{points} {lambda}"));
                let covariance = |found: &Shrunk| {
                    let factor = &found.solution.factor;
                    factor * factor.transpose()
                };
                let difference = covariance(&found) - covariance(&expected);
                assert!(difference.norm_max() < 1e-9 * covariance(&expected).norm_max());
            }
        }
    }
}
