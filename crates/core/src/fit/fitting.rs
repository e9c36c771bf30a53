//! Fits points according to the settings.

use super::config::{FitConfig, FitMethod, PriorKind};
use super::cosines::CosineBasis;
use super::estimate::Estimate;
use super::estimator::Estimator;
use super::joint::FieldEstimator;
use super::lstsq::Problem;
use super::outcome::Fit;
use super::points::{FitPoints, FitRows};
use super::prior::Prior;
use super::robust::{self, InlierPosterior};
use super::{guided, measured};
use crate::error::{FitError, Result};
use std::borrow::Cow;

/// Fits basis functions to points. `prior` is the prior learned for these basis functions, if any.
///
/// # Errors
/// No points, values that are not finite, a required prior that is not given, or a decomposition that does
/// not converge.
pub fn fit(points: &FitPoints<'_>, config: &FitConfig, prior: Option<&Prior>) -> Result<Fit> {
    let rough = config.robust.is_some();
    with_initial_fit(
        points,
        config,
        prior,
        rough,
        |mut rows, estimator, mut estimate, guide_trust| {
            if let Some(settings) = config.robust {
                let robust = robust::robust(&rows, estimator, estimate, settings)?;
                (estimate, rows.weights) = robust;
            }
            Ok(Fit::new(rows, estimate, guide_trust))
        },
    )
}

/// The probability that each point is an inlier, given its prediction from the others; errors and scales are in metres.
/// `config.robust` is ignored.
///
/// # Errors
/// As for [`fit()`].
pub fn inlier_posteriors(
    points: &FitPoints<'_>,
    config: &FitConfig,
    prior: Option<&Prior>,
) -> Result<Vec<InlierPosterior>> {
    with_initial_fit(points, config, prior, true, |rows, estimator, plain, _| {
        robust::inlier_posteriors(&rows, estimator, &plain)
    })
}

/// Checks points and settings, and calls `then` with the rows of the regression, the estimator, its estimate in which all
/// points count, and the standard deviation of the prior over the weights of a guide, if there is one.
fn with_initial_fit<T>(
    points: &FitPoints<'_>,
    config: &FitConfig,
    prior: Option<&Prior>,
    rough_only: bool,
    then: impl FnOnce(FitRows<'_>, Estimator<'_>, Estimate, Option<f64>) -> Result<T>,
) -> Result<T> {
    config.check()?;
    let mut rows = points.rows()?;
    let ridges = CosineBasis::up_to(config.cosines()).ridges(config.joint.bending);
    if !ridges.is_empty() && rows.columns() <= ridges.len() {
        return Err(FitError::Shape(format!(
            "{} columns are too few for basis functions and {} cosines",
            rows.columns(),
            ridges.len()
        ))
        .into());
    }
    let mut prior = match config.prior {
        PriorKind::Learned if config.method != FitMethod::Field => {
            let prior = prior.ok_or(FitError::NoPrior(
                "the weights hold no prior, as `lsdc calibrate` adds it",
            ))?;
            Some(prior.at(rows.values.len()))
        }
        PriorKind::None if config.method == FitMethod::Lse => None,
        _ => Some(Cow::Owned(Prior::flat(rows.columns() - ridges.len()))),
    };
    let field = match config.method {
        FitMethod::Lse => None,
        method @ (FitMethod::Field | FitMethod::Joint) => Some(FieldEstimator {
            geometry: points
                .geometry
                .ok_or(FitError::NoAffinities(method.name()))?,
            joint: match method {
                FitMethod::Field => config.joint.alone(),
                _ => config.joint,
            },
            prior: None,
            ridges: &ridges,
            surface: config.joint.surface,
        }),
    };
    let mut guide_trust = None;
    let learned = config.prior == PriorKind::Learned && config.method != FitMethod::Field;
    if let (Some(network), true) = (&prior, points.guides > 0 && learned) {
        let (moments, lambda) = if let Some(field) = field {
            let (moments, count) = field.sample_moments(&rows)?;
            (moments, config.field_lambda().at(count))
        } else {
            let problem = Problem::new(&rows.bases(), &rows.values, &rows.weights);
            (problem.moments(), config.lambda)
        };
        let (found, deviation) = guided::likeliest(network, points.guides, &moments, lambda)?;
        prior = Some(Cow::Owned(found));
        guide_trust = Some(deviation);
    }
    let estimator = match (field, prior.as_deref()) {
        (None, None) => Estimator::Plain(config.solver()),
        (None, Some(prior)) => Estimator::Shrunk(prior, config.lambda),
        (Some(field), prior) => Estimator::Field(FieldEstimator {
            prior: prior
                .filter(|_| config.method == FitMethod::Joint)
                .map(|prior| (prior, config.field_lambda())),
            ..field
        }),
    };
    let known = rows.variances.iter().any(|variance| *variance > 0.0);
    let rough = if rough_only || known {
        estimator.roughly()
    } else {
        estimator
    };
    let plain = rough.solve(&rows, &rows.weights)?;
    let solve = |weights: &[f64]| rough.solve(&rows, weights);
    let (mut plain, weights) = measured::weighted_by_variance(
        plain,
        &rows.variances,
        estimator.observation_precision(),
        solve,
    )?;
    rows.weights = weights;
    if known && !rough_only {
        plain = estimator.solve(&rows, &rows.weights)?;
    }
    then(rows, estimator, plain, guide_trust)
}
