//! Base functions and sparse depths to weights: the least-squares fit (paper section 3.3).

mod config;
mod joint;
mod lstsq;
mod noise;
mod outcome;
mod points;
mod prior;
mod reweighted;
mod robust;
mod running;
mod scene;
mod shrink;
mod space;
#[cfg(test)]
mod tests;

pub use config::{FitConfig, FitMethod, PriorKind};
pub use joint::{JointBackend, JointConfig, JointFit, Scenes, joint};
pub use lstsq::{Factored, LstsqBackend, Problem, Solution, Solver, lstsq};
pub use noise::LocalNoise;
pub use outcome::{Fit, root_mean_square};
pub use points::Points;
pub use prior::{ImageMoments, NoisePrior, Prior};
pub use reweighted::{Reweighting, RobustGradient, reweighted};
pub use robust::{Loss, Robust};
pub use running::RunningFit;
pub use scene::{Edges, Scene, Smooth};
pub use shrink::Lambda;
pub use space::Space;

use crate::error::{Error, Result};
use points::Rows;

/// How the weights are found for points that count by given weights.
#[derive(Clone, Copy, Debug)]
enum Estimator<'a> {
    Plain(Solver),
    Shrunk(&'a Prior, Lambda),
}

/// What an estimator finds.
#[derive(Clone, Debug)]
struct Estimate {
    solution: Solution,
    /// The variance of a point of weight 1 about the fit, in the squared unit of the space.
    noise: f64,
    /// How strongly the weights were drawn towards a prior.
    lambda: Option<f64>,
}

impl Estimator<'_> {
    fn solve(self, rows: &Rows<'_>, weights: &[f64]) -> Result<Estimate> {
        let problem = Problem::new(rows.bases, &rows.values, weights);
        match self {
            Self::Shrunk(prior, lambda) => problem.moments().shrunk(prior, lambda),
            Self::Plain(solver) => {
                let solution = problem.solve(solver)?;
                let residuals = rows.residuals(&solution.weights);
                let squares: f64 = residuals.iter().zip(weights).map(|(r, w)| w * r * r).sum();
                let used = weights.iter().filter(|w| **w > 0.0).count();
                let freedom = used.saturating_sub(solution.rank).max(1);
                Ok(Estimate {
                    solution,
                    noise: squares / freedom as f64,
                    lambda: None,
                })
            }
        }
    }
}

/// Fits base functions to points. `prior` is the one that was learned with the base functions, if
/// any.
///
/// # Errors
/// No point, values that are not finite, a prior that is asked for and not given, or a
/// decomposition that does not converge.
pub fn fit(points: &Points<'_>, config: &FitConfig, prior: Option<&Prior>) -> Result<Fit> {
    let rows = points.rows(config.space)?;
    if config.method != FitMethod::Lse {
        return fit_field(&rows, points.scene, config, prior);
    }
    let flat;
    let estimator = match config.prior {
        PriorKind::None => Estimator::Plain(config.solver()),
        PriorKind::Flat => {
            flat = Prior::flat(rows.columns());
            Estimator::Shrunk(&flat, config.lambda)
        }
        PriorKind::Learned => Estimator::Shrunk(learned(prior, config.space)?, config.lambda),
    };
    let plain = estimator.solve(&rows, &rows.weights)?;
    let (estimate, point_weights) = match config.robust {
        None => (plain, rows.weights.clone()),
        Some(settings) => robust::robust(&rows, estimator, plain, settings)?,
    };
    Ok(Fit::new(&rows, estimate, point_weights, config.space))
}

/// Fits with a field.
fn fit_field(
    rows: &Rows<'_>,
    scene: Option<Scene<'_>>,
    config: &FitConfig,
    prior: Option<&Prior>,
) -> Result<Fit> {
    let scene = scene.ok_or_else(|| {
        Error::config(format!(
            "`fit.method = \"{}\"` needs the image that the points lie in",
            config.method.name()
        ))
    })?;
    let flat;
    let prior = match (config.method, config.prior) {
        (FitMethod::Wls, _) => None,
        (_, PriorKind::Learned) => Some(learned(prior, config.space)?),
        _ => {
            flat = Prior::flat(rows.columns());
            Some(&flat)
        }
    };
    let prior = prior.map(|prior| (prior, config.lambda));
    let found = joint::solve(rows, &rows.weights, scene, config.joint.data, prior)?;
    let fit = Fit::new(rows, found.estimate, rows.weights.clone(), config.space);
    Ok(fit.with_field(found.smooth, &found.at_points))
}

/// A prior over the weights of depths says nothing of the weights of their logarithms.
fn learned(prior: Option<&Prior>, space: Space) -> Result<&Prior> {
    let missing =
        |what: &str| Err(Error::config(what).hint("set `fit.prior` to \"flat\" or \"none\""));
    match prior {
        Some(prior) if space == Space::Depth => Ok(prior),
        Some(_) => missing(
            "the learned prior is one over weights of depths, not of logarithms or inverses",
        ),
        None => missing("the weights hold no prior, as `lsdc calibrate` adds it"),
    }
}
