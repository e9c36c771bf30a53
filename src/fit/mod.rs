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
mod waves;

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
pub use shrink::{COUNTS, Lambda};
pub use space::Space;
pub use waves::Waves;

use crate::error::{Error, Result};
use joint::{FieldEstimator, FieldFit};
use points::Rows;
use std::borrow::Cow;
use std::sync::Arc;

/// How the weights are found for points that count by given weights.
#[derive(Clone, Copy, Debug)]
enum Estimator<'a> {
    Plain(Solver),
    Shrunk(&'a Prior, Lambda),
    Field(FieldEstimator<'a>),
}

/// What an estimator finds.
#[derive(Clone, Debug)]
struct Estimate {
    solution: Solution,
    /// What is left of each value.
    rests: Vec<f64>,
    /// The variance of a point of weight 1 about the fit, in the squared unit of the space.
    noise: f64,
    /// How strongly the weights were drawn towards a prior.
    lambda: Option<f64>,
    /// What base functions x weights are added to.
    field: Option<Arc<FieldFit>>,
}

impl Estimate {
    fn leverages(&self, bases: &[f32], weights: &[f64]) -> Vec<f64> {
        match &self.field {
            None => self.solution.leverages(bases, weights),
            Some(field) => field.leverages(&self.solution, weights),
        }
    }
}

impl Estimator<'_> {
    fn solve(self, rows: &Rows<'_>, weights: &[f64]) -> Result<Estimate> {
        let problem = || Problem::new(rows.bases, &rows.values, weights);
        match self {
            Self::Field(estimator) => estimator.solve(rows, weights),
            Self::Shrunk(prior, lambda) => {
                let found = problem().moments().shrunk(prior, lambda)?;
                Ok(Estimate {
                    rests: rows.residuals(&found.solution.weights),
                    solution: found.solution,
                    noise: found.noise,
                    lambda: Some(found.lambda),
                    field: None,
                })
            }
            Self::Plain(solver) => {
                let solution = problem().solve(solver)?;
                let rests = rows.residuals(&solution.weights);
                let squares: f64 = rests.iter().zip(weights).map(|(r, w)| w * r * r).sum();
                let used = weights.iter().filter(|w| **w > 0.0).count();
                let freedom = used.saturating_sub(solution.rank).max(1);
                Ok(Estimate {
                    solution,
                    rests,
                    noise: squares / freedom as f64,
                    lambda: None,
                    field: None,
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
    config.check()?;
    let rows = points.rows(config.space)?;
    let ridges = Waves::up_to(config.waves()).ridges(config.joint.bending);
    if !ridges.is_empty() && rows.columns() <= ridges.len() {
        return Err(Error::fit(format!(
            "{} columns are too few for base functions and {} waves",
            rows.columns(),
            ridges.len()
        ))
        .hint(
            "add the columns of `Waves` behind those of base functions, or set `joint.waves` to 0",
        ));
    }
    let prior = match config.prior {
        PriorKind::Learned if config.method != FitMethod::Wls => {
            Some(Cow::Borrowed(learned(prior, config.space)?))
        }
        PriorKind::None if config.method == FitMethod::Lse => None,
        _ => Some(Cow::Owned(Prior::flat(rows.columns() - ridges.len()))),
    };
    let estimator = match (config.method, prior.as_deref()) {
        (FitMethod::Lse, None) => Estimator::Plain(config.solver()),
        (FitMethod::Lse, Some(prior)) => Estimator::Shrunk(prior, config.lambda),
        (method, prior) => Estimator::Field(FieldEstimator {
            scene: points.scene.ok_or_else(|| no_scene(method))?,
            joint: match method {
                FitMethod::Wls => config.joint.alone(),
                _ => config.joint,
            },
            prior: prior
                .filter(|_| method == FitMethod::Joint)
                .map(|prior| (prior, config.field_lambda())),
            ridges: &ridges,
        }),
    };
    let plain = estimator.solve(&rows, &rows.weights)?;
    let (estimate, point_weights) = match config.robust {
        None => (plain, rows.weights.clone()),
        Some(settings) => robust::robust(&rows, estimator, plain, settings)?,
    };
    Ok(Fit::new(&rows, estimate, point_weights, config.space))
}

fn no_scene(method: FitMethod) -> Error {
    Error::config(format!(
        "`fit.method = \"{}\"` needs the image that the points lie in",
        method.name()
    ))
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
