//! Base functions and sparse depths to weights: the least-squares fit (paper section 3.3).

mod lstsq;
mod robust;

pub use lstsq::{LstsqBackend, Problem, Solution, Solver, lstsq};
pub use robust::{Loss, Robust, robust};

use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::fmt::{Display, Formatter};

/// How weights are found.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FitConfig {
    /// Singular values below this share of the largest are left out (paper Algorithm 1). The
    /// default is 129 times the epsilon of f32.
    pub rcond: f64,
    /// Added to the normal equations, as a share of their mean diagonal; 0 is the paper's fit.
    pub ridge: f64,
    /// A fit that does not follow outliers (paper Algorithm 2).
    #[serde(alias = "irls")]
    pub robust: Option<Robust>,
}

impl Default for FitConfig {
    fn default() -> Self {
        Self {
            rcond: 1.5e-5,
            ridge: 0.0,
            robust: None,
        }
    }
}

impl FitConfig {
    /// The solver of one linear problem.
    pub fn solver(&self) -> Solver {
        if self.ridge > 0.0 {
            Solver::Ridge(self.ridge)
        } else {
            Solver::Truncated(self.rcond)
        }
    }

    /// Checks every setting.
    ///
    /// # Errors
    /// The first setting that is out of range.
    pub fn check(&self) -> Result<()> {
        if !(0.0..1.0).contains(&self.rcond) {
            return Err(Error::config("`fit.rcond` must be in [0, 1)"));
        }
        if !(self.ridge >= 0.0 && self.ridge.is_finite()) {
            return Err(Error::config("`fit.ridge` must be 0 or more"));
        }
        self.robust.map_or(Ok(()), Robust::check)
    }
}

impl Display for FitConfig {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        if self.ridge > 0.0 {
            write!(f, "fit with a ridge of {}", self.ridge)?;
        } else {
            write!(f, "fit by SVD, truncated at {}", self.rcond)?;
        }
        match self.robust {
            None => Ok(()),
            Some(robust) => write!(
                f,
                ", {} of up to {} rounds",
                robust.loss.name(),
                robust.iterations
            ),
        }
    }
}

/// The outcome of a fit.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// Weights of the base functions, the constant first, in metres.
    pub weights: Vec<f64>,
    /// Depth minus fitted depth at each point, in metres.
    pub residuals: Vec<f64>,
    /// The weight of each point in the last solve: all 1 for a plain fit.
    pub point_weights: Vec<f64>,
    /// The number of directions that the points determine, at most N + 1.
    pub rank: usize,
}

impl Fit {
    /// Root mean square of the residuals, in metres.
    pub fn rms(&self) -> f64 {
        root_mean_square(&self.residuals)
    }
}

/// What the residual of each point would be, in metres, had it been left out of the fit: the residual
/// over 1 - leverage (Allen 1974). Their root mean square, the PRESS error, says without a true depth
/// map how far the depth is off between the points, where these are spread as the pixels are.
///
/// `bases` are those that were fitted, with the same settings.
///
/// # Errors
/// Values that are not finite.
pub fn left_out(bases: &[f32], fit: &Fit, config: &FitConfig) -> Result<Vec<f64>> {
    let residuals = &fit.residuals;
    let problem = Problem::new(bases, residuals, &fit.point_weights);
    let leverages = problem.leverages(config.solver(), residuals.len())?;
    Ok(without_own(residuals, &leverages))
}

/// Residuals over 1 - leverage. A point that a fit meets whatever its depth is says nothing: its
/// residual is 0 over 0, and stays small.
fn without_own(residuals: &[f64], leverages: &[f64]) -> Vec<f64> {
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

fn all_finite(values: &[f32]) -> bool {
    // Whole chunks at once, which vector units can do.
    let finite = |chunk: &[f32]| chunk.iter().fold(true, |all, v| all & v.is_finite());
    values.chunks(256).all(finite)
}

/// Fits `bases` (`depths.len()` rows of N + 1 values) to `depths` in metres.
///
/// # Errors
/// No point, values that are not finite, or a decomposition that does not converge.
pub fn fit(bases: &[f32], depths: &[f32], config: &FitConfig) -> Result<Fit> {
    if depths.is_empty() {
        return Err(Error::fit("there is no sparse depth to fit")
            .hint("give at least one pixel a positive, finite depth"));
    }
    let columns = bases.len() / depths.len();
    if !(all_finite(bases) && all_finite(depths)) || columns * depths.len() != bases.len() {
        return Err(Error::fit("base functions or depths are not finite")
            .hint("the weights of the network may be damaged"));
    }
    let depths: Vec<f64> = depths.iter().map(|&v| f64::from(v)).collect();
    let mut point_weights = vec![1.0; depths.len()];
    let mut solution = Problem::new(bases, &depths, &point_weights).solve(config.solver())?;
    if let Some(settings) = config.robust {
        (solution, point_weights) = robust(bases, &depths, solution, config.solver(), settings)?;
    }
    let residuals = lstsq::residuals(bases, &depths, &solution.weights);
    Ok(Fit {
        weights: solution.weights,
        residuals,
        point_weights,
        rank: solution.rank,
    })
}
