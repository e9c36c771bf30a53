//! Iteratively reweighted least squares (paper Algorithm 2): the fit of least absolute residuals,
//! rounded off at the threshold.

use super::lstsq::{Problem, Solution, Solver, residuals};
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// Settings of IRLS; the paper leaves threshold and stop open.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Irls {
    /// Residuals below this share of the median depth weigh alike. Relative, so that scaling all
    /// depths scales the result.
    pub threshold: f64,
    /// The largest number of solves after the first.
    pub iterations: usize,
    /// Stops when no weight changes by more than this share of the largest.
    pub tolerance: f64,
}

impl Default for Irls {
    fn default() -> Self {
        Self {
            threshold: 1e-3,
            iterations: 10,
            tolerance: 1e-4,
        }
    }
}

impl Irls {
    pub(super) fn check(self) -> Result<()> {
        if self.threshold > 0.0 && self.threshold.is_finite() && self.tolerance >= 0.0 {
            Ok(())
        } else {
            Err(Error::config(
                "`fit.irls.threshold` must be above 0 and `tolerance` at least 0",
            ))
        }
    }
}

/// Continues from the plain `start` with point weights `1 / max(threshold, |residual|)`.
///
/// Returns the last solution and the point weights it was solved with, scaled to at most 1.
///
/// # Errors
/// A decomposition that does not converge.
pub fn irls<T: Copy + Into<f64>>(
    bases: &[T],
    depths: &[f64],
    start: Solution,
    solver: Solver,
    settings: Irls,
) -> Result<(Solution, Vec<f64>)> {
    let mut sorted = depths.to_vec();
    sorted.sort_by(f64::total_cmp);
    let threshold = settings.threshold * sorted[sorted.len() / 2];
    let mut solution = start;
    let mut weights = vec![1.0; depths.len()];
    for _ in 0..settings.iterations {
        weights = residuals(bases, depths, &solution.weights)
            .into_iter()
            .map(|r| threshold / r.abs().max(threshold))
            .collect();
        let next = Problem::new(bases, depths, &weights).solve(solver)?;
        let largest = next.weights.iter().fold(0.0, |m: f64, w| m.max(w.abs()));
        let change = next
            .weights
            .iter()
            .zip(&solution.weights)
            .fold(0.0, |m: f64, (a, b)| m.max((a - b).abs()));
        solution = next;
        if change <= settings.tolerance * largest {
            break;
        }
    }
    Ok((solution, weights))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_constant_fitted_to_outliers_is_their_median() {
        // The least absolute deviation estimate of a location is the median.
        let depths = [1.0, 1.1, 1.2, 1.3, 9.0, 9.5, 1.15];
        let bases = [1.0; 7];
        let solver = Solver::Truncated(1e-12);
        let start = Problem::new(&bases, &depths, &[1.0; 7])
            .solve(solver)
            .unwrap();
        let settings = Irls {
            threshold: 1e-6,
            iterations: 200,
            tolerance: 1e-12,
        };
        let (solution, weights) = irls(&bases, &depths, start, solver, settings).unwrap();
        assert!(
            (solution.weights[0] - 1.2).abs() < 1e-3,
            "{:?}",
            solution.weights
        );
        assert!(weights[4] < 1e-3);
    }
}
