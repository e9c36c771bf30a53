//! Iteratively reweighted least squares (paper Algorithm 2) with the weights of the paper or of the classic
//! M-estimators.

use super::{Loss, Robust};
use crate::error::Result;
use crate::fit::estimate::Estimate;
use crate::fit::estimator::Estimator;
use crate::fit::leave_one_out::leave_one_out;
use crate::fit::medians::{deviation, weighted_median};
use crate::fit::points::FitRows;
use crate::nearest::NeighbourGrid;

impl Loss {
    /// The weight at a residual of `u` scales.
    fn weight(self, u: f64) -> f64 {
        match self {
            Self::Irls | Self::Huber => 1.0 / u.abs().max(1.0),
            Self::Cauchy => 1.0 / (1.0 + u * u),
            Self::Gm => (1.0 + u * u).powi(-2),
            Self::Tukey => (1.0 - u * u).max(0.0).powi(2),
            Self::Auto => 1.0,
        }
    }

    /// Standard deviations of the noise in one scale: 95 % efficiency where there is no outlier
    /// (Holland and Welsch 1977; Geman-McClure's is the Cauchy constant times the square root of
    /// 2, for the same curvature).
    fn tuning(self) -> f64 {
        match self {
            Self::Irls | Self::Auto => 1.0,
            Self::Huber => 1.345,
            Self::Cauchy => 2.385,
            Self::Gm => 3.373,
            Self::Tukey => 4.685,
        }
    }

    /// Whether distant points lose all influence, so that the result depends on the starting point.
    pub(super) fn redescends(self) -> bool {
        matches!(self, Self::Cauchy | Self::Gm | Self::Tukey)
    }
}

/// Continues from the plain estimate. Returns the last estimate and the point weights it was found with.
///
/// Losses other than the paper's use leave-one-out residuals, so that an outlier that bends the fit towards itself is detected,
/// and derive their scale from the median of the absolute residuals. In a fit with a field, a loss scales the leverage of each
/// point instead of its weight. Redescending losses start from Huber's solution, with a scale that includes every point and
/// shrinks by a constant factor in each iteration (graduated non-convexity, Blake and Zisserman 1987) until it is that of the
/// noise. With no more points than directions, outliers cannot be detected, and all points keep their weight.
///
/// # Errors
/// A decomposition that does not converge.
pub(super) fn reweighted(
    rows: &FitRows<'_>,
    estimator: Estimator<'_>,
    plain: Estimate,
    settings: Robust,
) -> Result<(Estimate, Vec<f64>)> {
    let (loss, own) = (settings.loss, &rows.weights);
    if loss != Loss::Irls && rows.values.len() <= plain.solution.rank {
        return Ok((plain, own.clone()));
    }
    let (mut estimate, mut weights) = if loss.redescends() {
        let huber = Robust {
            neighbours: settings.neighbours,
            ..Robust::new(Loss::Huber)
        };
        reweighted(rows, estimator, plain, huber)?
    } else {
        (plain, own.clone())
    };
    let neighbourhood = match (loss, rows.places) {
        (Loss::Irls, _) | (_, None) => None,
        (_, Some(_)) if settings.neighbours == 0 => None,
        (_, Some(places)) => Some(Neighbourhood::new(places, settings.neighbours)),
    };
    let mut widening = f64::INFINITY;
    let mut odds = vec![0.0; own.len()];
    for _ in 0..settings.iterations {
        let mut found = estimate.residuals.clone();
        let scale = if loss == Loss::Irls {
            settings.threshold * rows.unit()
        } else {
            let leverages = estimate.leverages(rows, &weights);
            found = leave_one_out(&found, &leverages, estimate.field.is_some());
            if estimate.field.is_some() {
                update_odds(&mut odds, &leverages, &weights, own);
            }
            if let Some(neighbourhood) = &neighbourhood {
                found = neighbourhood.apart(&found, &weights);
            }
            // In units of the given deviation of each point.
            found.iter_mut().zip(own).for_each(|(r, w)| *r *= w.sqrt());
            settings.tuning.unwrap_or(loss.tuning()) * deviation(&found)
        };
        // If all points are interpolated exactly, there is no scale and nothing to do.
        if scale <= 0.0 {
            break;
        }
        widening = if loss.redescends() {
            let farthest = found.iter().fold(0.0, |m: f64, r| m.max(r.abs()));
            (widening / SHRINKING).min(farthest / scale).max(1.0)
        } else {
            1.0
        };
        weights = found
            .iter()
            .zip(own)
            .zip(&odds)
            .map(|((r, own), odds)| own * damped(loss.weight(r / (widening * scale)), *odds))
            .collect();
        let next = estimator.solve(rows, &weights)?;
        let largest = rows.values.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
        let pairs = estimate.residuals.iter().zip(&next.residuals);
        let change = pairs.fold(0.0, |m: f64, (a, b)| m.max((a - b).abs()));
        estimate = next;
        if widening == 1.0 && change <= settings.tolerance * largest {
            break;
        }
    }
    Ok((estimate, weights))
}

/// Returns the weight at which a point with the `odds` h / (1 - h) has the leverage `weight` h: the odds are proportional to
/// the weight. If points determine a field nearly alone, h is close to 1, and a weight of a half or a hundredth would not
/// change this: outliers would still be interpolated.
fn damped(weight: f64, odds: f64) -> f64 {
    weight / (1.0 + odds * (1.0 - weight))
}

/// Updates the odds h / (1 - h) of each point's leverage h at its own weight, from leverages at smaller weights; odds are
/// proportional to weights. Points without weight keep their odds.
fn update_odds(odds: &mut [f64], leverages: &[f64], weights: &[f64], own: &[f64]) {
    for (((odds, h), weight), own) in odds.iter_mut().zip(leverages).zip(weights).zip(own) {
        let found = h / (1.0 - h).max(f64::EPSILON) * own / weight;
        if found.is_finite() && found >= 0.0 {
            *odds = found;
        }
    }
}

/// Factor by which the scale of a redescending loss shrinks in a round.
const SHRINKING: f64 = 1.4;

/// The nearest points of each point.
struct Neighbourhood(Vec<Vec<(f64, usize)>>);

impl Neighbourhood {
    fn new(places: &[[f64; 2]], count: usize) -> Self {
        let cells = NeighbourGrid::new(places);
        let nearest = |(i, place): (usize, &[f64; 2])| -> Vec<(f64, usize)> {
            let found = cells.nearest(*place, count + 1).into_iter();
            found
                .filter(|(_, j)| *j != i)
                .take(count)
                .map(|(square, j)| (square.sqrt(), j))
                .collect()
        };
        Self(places.iter().enumerate().map(nearest).collect())
    }

    /// Returns residuals minus the median of those of the neighbours; near and trusted neighbours have the largest weights.
    fn apart(&self, residuals: &[f64], weights: &[f64]) -> Vec<f64> {
        const LEAST: f64 = 0.05;
        let largest = weights
            .iter()
            .fold(f64::MIN_POSITIVE, |m: f64, w| m.max(*w));
        let local = |(neighbours, own): (&Vec<(f64, usize)>, &f64)| {
            let pairs = neighbours.iter().map(|&(distance, j)| {
                let trust = (weights[j] / largest).max(LEAST);
                (residuals[j], trust / (1.0 + distance))
            });
            own - weighted_median(pairs.collect())
        };
        self.0.iter().zip(residuals).map(local).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::{FitConfig, FitPoints, fit};
    use lsdc_rng::Rng;

    fn fitted(bases: &[f32], depths: &[f32], robust: Option<Robust>) -> (Vec<f64>, Vec<f64>) {
        let config = FitConfig {
            rcond: 1e-12,
            robust,
            ..FitConfig::default()
        };
        let fit = fit(&FitPoints::new(bases, depths), &config, None).unwrap();
        (fit.weights, fit.point_weights)
    }

    #[test]
    fn a_constant_fitted_to_outliers_is_their_median() {
        // The least absolute deviation estimate of a location is the median.
        let depths = [1.0, 1.1, 1.2, 1.3, 9.0, 9.5, 1.15];
        let settings = Robust {
            threshold: 1e-6,
            iterations: 200,
            tolerance: 1e-12,
            ..Robust::default()
        };
        let (solution, weights) = fitted(&[1.0; 7], &depths, Some(settings));
        assert!((solution[0] - 1.2).abs() < 1e-3, "{solution:?}");
        assert!(weights[4] < 1e-3);
    }

    #[test]
    fn a_damped_point_has_that_share_of_its_leverage() {
        for (leverage, weight) in [(0.999, 0.5), (0.2, 0.01), (0.6, 1.0), (0.9, 0.0)] {
            let odds = leverage / (1.0 - leverage);
            let after = odds * damped(weight, odds);
            let found = after / (1.0 + after);
            assert!((found - weight * leverage).abs() < 1e-12, "{found}");
        }
    }

    /// A line through `count` noisy points of which a share was raised.
    fn line(count: usize, share: f32) -> (Vec<f32>, Vec<f32>) {
        let mut rng = Rng::stream(5, &["line"]);
        let mut bases = Vec::new();
        let mut depths = Vec::new();
        for i in 0..count {
            let x = i as f32 / count as f32;
            bases.extend([1.0, x]);
            let raised = if rng.chance(share) {
                1.0 + rng.unit()
            } else {
                0.0
            };
            depths.push(2.0 + 3.0 * x + 0.01 * rng.normal() + raised);
        }
        (bases, depths)
    }

    #[test]
    fn losses_that_redescend_forget_outliers() {
        let (bases, depths) = line(400, 0.3);
        for loss in [Loss::Cauchy, Loss::Gm, Loss::Tukey] {
            let (solution, weights) = fitted(&bases, &depths, Some(Robust::new(loss)));
            assert!((solution[0] - 2.0).abs() < 0.01, "{loss:?} {solution:?}");
            assert!((solution[1] - 3.0).abs() < 0.01, "{loss:?} {solution:?}");
            let dismissed = weights.iter().filter(|w| **w < 0.1).count();
            assert!((100..140).contains(&dismissed), "{loss:?} {dismissed}");
        }
        // Least absolute residuals follow them a little, least squares far.
        let (solution, _) = fitted(&bases, &depths, Some(Robust::default()));
        assert!((solution[0] - 2.0).abs() < 0.05);
    }

    #[test]
    fn without_outliers_every_loss_is_nearly_least_squares() {
        let (bases, depths) = line(400, 0.0);
        let (plain, _) = fitted(&bases, &depths, None);
        for loss in Loss::ALL {
            let (solution, _) = fitted(&bases, &depths, Some(Robust::new(loss)));
            for (a, b) in solution.iter().zip(&plain) {
                assert!((a - b).abs() < 2e-3, "{loss:?} {a} {b}");
            }
        }
    }

    #[test]
    fn scaling_depths_scales_every_robust_fit() {
        let (bases, depths) = line(60, 0.2);
        // A power of two, which is exact.
        let far: Vec<f32> = depths.iter().map(|d| 8.0 * d).collect();
        for loss in Loss::ALL {
            let (near, _) = fitted(&bases, &depths, Some(Robust::new(loss)));
            let (far, _) = fitted(&bases, &far, Some(Robust::new(loss)));
            for (a, b) in near.iter().zip(&far) {
                assert!((8.0 * a - b).abs() < 1e-9 * b.abs(), "{loss:?} {a} {b}");
            }
        }
    }

    #[test]
    fn too_few_points_all_count() {
        let (solution, weights) = fitted(
            &[1.0, 0.0, 1.0, 1.0],
            &[2.0, 5.0],
            Some(Robust::new(Loss::Tukey)),
        );
        assert_eq!(weights, [1.0, 1.0]);
        assert!((solution[1] - 3.0).abs() < 1e-9);
    }
}
