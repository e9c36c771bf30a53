//! The fit against closed forms written out in full, and against problems of every kind.

use super::lstsq::Problem;
use super::prior::{ImageMoments, NoisePrior, Prior};
use super::{Fit, FitConfig, FitPoints, Lambda, PriorKind, Robust, fit};
use faer::linalg::solvers::{DenseSolveCore as _, Solve as _, SolveLstsq as _};
use faer::{Mat, Side};
use lsdc_rng::Rng;

fn normal(rng: &mut Rng, count: usize) -> Vec<f32> {
    (0..count).map(|_| rng.normal()).collect()
}

/// A prior over `k` weights, of rank `r`.
fn prior(k: usize, r: usize, noise: NoisePrior) -> Prior {
    let mut rng = Rng::stream(3, &["prior"]);
    Prior::new(&normal(&mut rng, k), &normal(&mut rng, k * r), noise).unwrap()
}

const UNKNOWN: NoisePrior = NoisePrior {
    mean: -1.0,
    deviation: None,
    equivalent_points: 0.0,
};

fn learned(lambda: Lambda) -> FitConfig {
    FitConfig {
        prior: PriorKind::Learned,
        lambda,
        ..FitConfig::default()
    }
}

/// Bases, and depths about a multiple of the mean map, of `n` points.
fn scene(prior: &Prior, n: usize, noise: f32, seed: u64) -> (Vec<f32>, Vec<f32>) {
    let k = prior.columns();
    let mut rng = Rng::stream(seed, &["scene"]);
    let bases = normal(&mut rng, n * k);
    let u = normal(&mut rng, prior.factor.ncols());
    let weights: Vec<f64> = (0..k)
        .map(|i| {
            let off: f64 = u
                .iter()
                .enumerate()
                .map(|(j, u)| prior.factor[(i, j)] * f64::from(*u))
                .sum();
            3.0 * (prior.mean[i] + off)
        })
        .collect();
    let depths = bases.chunks_exact(k).map(|row| {
        let sum: f64 = row
            .iter()
            .zip(&weights)
            .map(|(f, w)| f64::from(*f) * w)
            .sum();
        (sum as f32) + 3.0 * noise * rng.normal()
    });
    let depths = depths.collect();
    (bases, depths)
}

/// A prior fit in full: weights with covariance L L^T + a huge multiple of m m^T, noise lambda.
fn generalised(prior: &Prior, bases: &[f32], depths: &[f32], lambda: f64) -> Vec<f64> {
    let (n, k) = (depths.len(), prior.columns());
    let f = Mat::from_fn(n, k, |i, j| f64::from(bases[i * k + j]));
    let mean = Mat::from_fn(k, 1, |i, _| prior.mean[i]);
    let covariance =
        &prior.factor * prior.factor.transpose() + &mean * mean.transpose() * faer::Scale(1e8);
    let marginal =
        &f * &covariance * f.transpose() + Mat::<f64>::identity(n, n) * faer::Scale(lambda);
    let d = Mat::from_fn(n, 1, |i, _| f64::from(depths[i]));
    let weights = &covariance * f.transpose() * marginal.llt(Side::Lower).unwrap().solve(d);
    (0..k).map(|i| weights[(i, 0)]).collect()
}

fn close(a: &[f64], b: &[f64], tolerance: f64) {
    let scale = b.iter().fold(1e-9, |m: f64, v| m.max(v.abs()));
    for (a, b) in a.iter().zip(b) {
        assert!((a - b).abs() <= tolerance * scale, "{a} instead of {b}");
    }
}

#[test]
fn a_prior_fit_is_the_mean_of_the_gaussian_posterior() {
    let prior = prior(6, 4, UNKNOWN);
    for n in [1, 2, 5, 40] {
        let (bases, depths) = scene(&prior, n, 0.1, n as u64);
        for lambda in [1e-2, 0.3] {
            let points = FitPoints::new(&bases, &depths);
            let fit = fit(&points, &learned(Lambda::Fixed(lambda)), Some(&prior)).unwrap();
            close(
                &fit.weights,
                &generalised(&prior, &bases, &depths, lambda),
                1e-5,
            );
        }
    }
}

#[test]
fn a_single_point_scales_the_mean_map() {
    let prior = prior(6, 4, UNKNOWN);
    // Values whose products are rounded.
    let bases = [1.0, 0.3, -0.2, 0.5, 2.0, -1.0];
    for lambda in [Lambda::Evidence, Lambda::Gcv, Lambda::Fixed(1e-9)] {
        let points = FitPoints::new(&bases, &[2.5]);
        let fit = fit(&points, &learned(lambda), Some(&prior)).unwrap();
        let pairs = prior.mean.iter().zip(&bases);
        let at: f64 = pairs.map(|(m, f)| m * f64::from(*f)).sum();
        let expected: Vec<f64> = prior.mean.iter().map(|m| m * 2.5 / at).collect();
        close(&fit.weights, &expected, 1e-12);
    }
}

#[test]
fn the_centre_of_a_prior_moves_with_the_number_of_points() {
    let plain = prior(6, 4, UNKNOWN);
    let pooled = normal(&mut Rng::stream(4, &["pooled"]), 6);
    let both = plain.clone().with_pooled(&pooled).unwrap();
    assert_eq!(both.pooled(), Some(pooled.clone()));
    let found = |n: usize, prior: &Prior| {
        let (bases, depths) = scene(&plain, n, 0.1, n as u64);
        let points = FitPoints::new(&bases, &depths);
        let fit = fit(&points, &learned(Lambda::Fixed(0.3)), Some(prior)).unwrap();
        (fit.weights, bases, depths)
    };
    // A single point scales the regression's weights.
    let (weights, bases, depths) = found(1, &both);
    let pairs = pooled.iter().zip(&bases);
    let at: f32 = pairs.map(|(m, f)| m * f).sum();
    let expected = pooled.iter().map(|m| f64::from(m * depths[0] / at));
    close(&weights, &expected.collect::<Vec<_>>(), 1e-5);
    // Half way, in logarithms, between one point and 50.
    let (weights, bases, depths) = found(7, &both);
    let share = 1.0 - (7.0_f64).ln() / (50.0_f64).ln();
    let centre = plain.numbers().0.into_iter().zip(&pooled);
    let centre = centre.map(|(m, p)| m + share as f32 * (p - m));
    let (_, factor) = plain.numbers();
    let between = Prior::new(&centre.collect::<Vec<_>>(), &factor, UNKNOWN).unwrap();
    close(&weights, &generalised(&between, &bases, &depths, 0.3), 1e-5);
    assert_eq!(found(50, &both).0, found(50, &plain).0);
    // It has no effect if the prior is centred on another fit.
    let about = both
        .centred_on(&[2.0, 1.0, 0.0, -1.0, 0.5, 0.25], 0)
        .unwrap();
    assert_eq!(about.pooled(), None);

    let refused = |weights: &[f32]| plain.clone().with_pooled(weights).is_err();
    assert!(refused(&pooled[1..]));
    assert!(refused(&[f32::NAN; 6]));
}

#[test]
fn scaling_depths_scales_every_fit() {
    let known = NoisePrior {
        mean: -3.0,
        deviation: Some(0.5),
        equivalent_points: 5.0,
    };
    let prior = prior(6, 4, known).with_pooled(&[0.5; 6]).unwrap();
    let configs = [
        learned(Lambda::Evidence),
        learned(Lambda::Gcv),
        FitConfig {
            prior: PriorKind::Flat,
            ..FitConfig::default()
        },
        FitConfig {
            robust: Some(Robust::default()),
            ..learned(Lambda::Evidence)
        },
    ];
    for n in [1, 3, 30] {
        let (bases, depths) = scene(&prior, n, 0.1, 7);
        // The scaled values are depths, which are positive.
        let depths: Vec<f32> = depths.iter().map(|d| d.abs() + 0.1).collect();
        for config in &configs {
            let weights = |factor: f32| {
                let depths: Vec<f32> = depths.iter().map(|d| d * factor).collect();
                fit(&FitPoints::new(&bases, &depths), config, Some(&prior))
                    .unwrap()
                    .weights
            };
            let near = weights(1.0);
            for factor in [0.125, 8.0] {
                let far: Vec<f64> = weights(factor)
                    .iter()
                    .map(|w| w / f64::from(factor))
                    .collect();
                close(&far, &near, 1e-9);
            }
        }
    }
}

#[test]
fn the_evidence_is_the_likelihood_of_the_depths() {
    // -2 ln p of the depths' contrasts, with the noise's variance at its best, from full matrices.
    let prior = prior(5, 3, UNKNOWN);
    let n = 12;
    let (bases, depths) = scene(&prior, n, 0.2, 1);
    let f = Mat::from_fn(n, 5, |i, j| f64::from(bases[i * 5 + j]));
    let mean = &f * Mat::from_fn(5, 1, |i, _| prior.mean[i]);
    // An orthonormal basis of what is orthogonal to the mean map.
    let full = mean.qr().compute_Q();
    let contrasts = full.subcols(1, n - 1).transpose() * &f * &prior.factor;
    let d = full.subcols(1, n - 1).transpose() * Mat::from_fn(n, 1, |i, _| f64::from(depths[i]));
    let cost = |lambda: f64| {
        let marginal = &contrasts * contrasts.transpose() * faer::Scale(1.0 / lambda)
            + Mat::<f64>::identity(n - 1, n - 1);
        let factor = marginal.llt(Side::Lower).unwrap();
        let square = (d.transpose() * factor.solve(&d))[(0, 0)];
        let volume: f64 = (0..n - 1).map(|i| factor.L()[(i, i)].ln()).sum();
        (n - 1) as f64 * square.ln() + 2.0 * volume
    };
    let found = fit(
        &FitPoints::new(&bases, &depths),
        &learned(Lambda::Evidence),
        Some(&prior),
    );
    let lambda = found.unwrap().lambda.unwrap();
    for other in [0.2, 0.5, 0.9, 1.1, 2.0, 5.0] {
        assert!(cost(lambda) < cost(other * lambda), "{other}");
    }
    // Stationary at the minimum that was found.
    assert!((cost(1.001 * lambda) - cost(0.999 * lambda)).abs() < 1e-5);
}

#[test]
fn evidence_and_cross_validation_find_the_noise() {
    let prior = prior(8, 6, UNKNOWN);
    for lambda in [Lambda::Evidence, Lambda::Gcv] {
        let mut sum = 0.0;
        for seed in 0..40 {
            let (bases, depths) = scene(&prior, 60, 0.1, seed);
            let points = FitPoints::new(&bases, &depths);
            let fit = fit(&points, &learned(lambda), Some(&prior)).unwrap();
            sum += fit.noise.sqrt() / 40.0;
        }
        // Depths are 3 x the map, and the noise 0.1 of that.
        assert!((sum - 0.3).abs() < 0.01, "{lambda:?} {sum}");
    }
}

#[test]
fn the_noise_is_known_beforehand_where_points_are_few() {
    let known = NoisePrior {
        mean: (0.01_f64).ln(),
        deviation: Some(0.1),
        equivalent_points: 5.0,
    };
    let prior = prior(6, 4, known);
    let (bases, depths) = scene(&prior, 2, 0.1, 5);
    let fit = fit(
        &FitPoints::new(&bases, &depths),
        &learned(Lambda::Evidence),
        Some(&prior),
    )
    .unwrap();
    let ratio = fit.lambda.unwrap() / 0.01;
    assert!((0.7..1.4).contains(&ratio), "{ratio}");
}

#[test]
fn lambda_follows_the_number_of_points() {
    let prior = prior(6, 4, UNKNOWN);
    let given = "lambda = [[2, 1e-3], [8, 1e-1], [32, 0.4]]";
    let config: FitConfig = toml::from_str(&format!("prior = \"learned\"\n{given}")).unwrap();
    assert!(config.check().is_ok());
    for (points, expected) in [
        (1, 1e-3),
        (2, 1e-3),
        (4, 1e-2),
        (8, 0.1),
        (16, 0.2),
        (99, 0.4),
    ] {
        let (bases, depths) = scene(&prior, points, 0.2, 2);
        let points = FitPoints::new(&bases, &depths);
        let found = fit(&points, &config, Some(&prior)).unwrap();
        assert!((found.lambda.unwrap() / expected - 1.0).abs() < 1e-12);
        let fixed = fit(&points, &learned(Lambda::Fixed(expected)), Some(&prior)).unwrap();
        for (a, b) in found.weights.iter().zip(&fixed.weights) {
            assert!((a - b).abs() < 1e-9);
        }
    }
    for wrong in ["[[2, 1], [2, 1], [3, 1]]", "[[2, 1], [3, 0], [4, 1]]"] {
        let config: FitConfig = toml::from_str(&format!("lambda = {wrong}")).unwrap();
        assert!(config.check().is_err(), "{wrong}");
    }
}

#[test]
fn leverages_and_left_out_residuals_are_those_of_fits_without_the_point() {
    let prior = prior(6, 4, UNKNOWN);
    let (bases, depths) = scene(&prior, 15, 0.2, 2);
    let config = learned(Lambda::Fixed(0.05));
    let whole = fit(&FitPoints::new(&bases, &depths), &config, Some(&prior)).unwrap();
    let found = whole.leave_one_out(&whole.leverages(&bases));
    for (i, found) in found.iter().enumerate() {
        let (mut bases, mut depths) = (bases.clone(), depths.clone());
        let row: Vec<f32> = bases.drain(i * 6..(i + 1) * 6).collect();
        let depth = depths.remove(i);
        let other = fit(&FitPoints::new(&bases, &depths), &config, Some(&prior)).unwrap();
        let fitted: f64 = row
            .iter()
            .zip(&other.weights)
            .map(|(f, w)| f64::from(*f) * w)
            .sum();
        close(&[f64::from(depth) - fitted], &[*found], 1e-6);
    }
}

#[test]
fn variances_are_those_of_the_posterior() {
    // K K^T is the inverse of F^T F + lambda (L L^T)^-1 where the prior has full rank and the scale
    // is free: seen by a fit to unit depths, whose covariance is that of a linear map.
    let prior = prior(5, 5, UNKNOWN);
    let (bases, depths) = scene(&prior, 9, 0.2, 4);
    let found = fit(
        &FitPoints::new(&bases, &depths),
        &learned(Lambda::Fixed(0.2)),
        Some(&prior),
    )
    .unwrap();
    let f = Mat::from_fn(9, 5, |i, j| f64::from(bases[i * 5 + j]));
    let mean = Mat::from_fn(5, 1, |i, _| prior.mean[i]);
    let covariance =
        &prior.factor * prior.factor.transpose() + &mean * mean.transpose() * faer::Scale(1e7);
    let precision = f.transpose() * &f + covariance.partial_piv_lu().inverse() * faer::Scale(0.2);
    let expected = precision.partial_piv_lu().inverse();
    let row = [0.3_f32, -1.0, 0.7, 0.2, 1.5];
    let square: f64 = (0..5)
        .flat_map(|i| (0..5).map(move |j| (i, j)))
        .map(|(i, j)| f64::from(row[i]) * expected[(i, j)] * f64::from(row[j]))
        .sum();
    close(&[f64::from(found.spreads(&row)[0])], &[square], 1e-4);
}

#[test]
fn a_prior_is_learned_from_images() {
    // Many images with many points each, weights drawn from a known prior: its moments come back,
    // as far as 400 draws determine them.
    let truth = Prior::new(&[1.0, 0.2, -0.1], &[0.3, 0.0, 0.2, 0.1, 0.0, 0.2], UNKNOWN).unwrap();
    let mut all = (Vec::new(), Vec::new());
    let images: Vec<ImageMoments> = (0..400)
        .map(|seed| {
            let mut rng = Rng::stream(seed, &["image"]);
            let u = normal(&mut rng, 2);
            let mut bases = Vec::new();
            let mut depths = Vec::new();
            for _ in 0..60 {
                // With means of 0 the mean depth is that of the constant.
                let row = [1.0, rng.normal(), rng.normal()];
                let weight = |i: usize| {
                    truth.mean[i]
                        + (0..2)
                            .map(|j| truth.factor[(i, j)] * f64::from(u[j]))
                            .sum::<f64>()
                };
                let depth: f64 = (0..3).map(|i| f64::from(row[i]) * weight(i)).sum();
                bases.extend(row);
                depths.push(5.0 * (depth as f32 + 0.05 * rng.normal()) + 20.0);
            }
            // An offset of 4 keeps every depth positive: weights (5 w + 20, 5 w, 5 w) over their
            // mean depth.
            let mean = depths.iter().sum::<f32>() / depths.len() as f32;
            all.0.extend(bases.iter().map(|&f| f64::from(f)));
            all.1.extend(depths.iter().map(|d| f64::from(d / mean)));
            ImageMoments::new(&FitPoints::new(&bases, &depths)).unwrap()
        })
        .collect();
    let prior = Prior::learn(&images).unwrap();
    // E[5 w / (5 w0 + 20)] with w0 about 1: the first weight is nearly 1, the others a 25th of 5 w.
    assert!((prior.mean[0] - 1.0).abs() < 0.01, "{:?}", prior.mean);
    assert!((prior.mean[1] - 0.04).abs() < 0.006, "{:?}", prior.mean);
    let covariance = &prior.factor * prior.factor.transpose();
    let second = 0.2_f64.powi(2) * (0.2 * 0.2 + 0.1 * 0.1) * 1.0;
    assert!(
        (covariance[(1, 1)] / second - 1.0).abs() < 0.25,
        "{}",
        covariance[(1, 1)] / second
    );
    assert!((prior.noise().mean.exp().sqrt() - 0.01).abs() < 1e-3);
    let rows = Mat::from_fn(all.1.len(), 3, |i, j| all.0[3 * i + j]);
    let depths = Mat::from_fn(all.1.len(), 1, |i, _| all.1[i]);
    let regression = rows.qr().solve_lstsq(depths);
    let pooled = prior.pooled().unwrap();
    let pooled: Vec<f64> = pooled.into_iter().map(f64::from).collect();
    let expected: Vec<f64> = regression.col(0).iter().copied().collect();
    close(&pooled, &expected, 1e-5);
}

#[test]
fn numbers_of_a_prior_come_back_and_damaged_ones_are_refused() {
    let prior = prior(4, 3, UNKNOWN);
    let (mean, factor) = prior.numbers();
    assert_eq!(Prior::new(&mean, &factor, UNKNOWN).unwrap(), prior);
    assert!(Prior::new(&mean, &factor[1..], UNKNOWN).is_err());
    assert!(Prior::new(&[f32::NAN; 4], &factor, UNKNOWN).is_err());
    assert!(Prior::new(&[], &[], UNKNOWN).is_err());
    let (bases, depths) = scene(&prior, 3, 0.1, 0);
    let error = fit(
        &FitPoints::new(&bases, &depths),
        &learned(Lambda::Evidence),
        None,
    )
    .unwrap_err();
    assert!(error.to_string().contains("no prior"), "{error}");
    assert!(
        fit(
            &FitPoints::new(&bases[..6], &depths),
            &learned(Lambda::Evidence),
            Some(&prior)
        )
        .is_err()
    );
}

/// Files of earlier versions name what is fitted.
#[test]
fn other_functions_of_depth_are_refused() {
    let read = |text: &str| toml::from_str::<FitConfig>(text);
    assert_eq!(read("space = \"depth\"").unwrap(), FitConfig::default());
    assert!(
        !toml::to_string(&FitConfig::default())
            .unwrap()
            .contains("space")
    );
    for name in ["log", "inverse"] {
        let error = read(&format!("space = \"{name}\"")).unwrap_err();
        assert!(error.message().contains("until 0.2.0"), "{error}");
        assert!(error.message().contains(name), "{error}");
    }
}

/// The mean of 1 +- 0.5 and 1.1 +- 1, which agree as closely as their deviations say: (4 + 1.1) / 5.
#[test]
fn points_that_agree_within_their_deviations_are_weighted_by_them() {
    let points = FitPoints {
        deviations: Some(&[Some(0.5), Some(1.0)]),
        ..FitPoints::new(&[1.0, 1.0], &[1.0, 1.1])
    };
    let found = fit(&points, &FitConfig::default(), None).unwrap();
    assert!(
        (found.weights[0] - 1.02).abs() < 1e-6,
        "{}",
        found.weights[0]
    );
    let wrong = FitPoints {
        deviations: Some(&[Some(0.1), Some(0.0)]),
        ..points
    };
    assert!(fit(&wrong, &FitConfig::default(), None).is_err());
}

/// With the variance s2 that a constant leaves unexplained, the squares of residuals over s2 + sigma^2 have the
/// mean 1, taking one for the constant (Paule and Mandel 1982).
#[test]
fn what_deviations_do_not_explain_is_left_to_the_model() {
    let depths = [1.0, 3.0, 2.0, 5.0, 4.0];
    let sigmas = [0.1, 1.0, 0.5, 2.0, 0.2];
    let points = FitPoints {
        deviations: Some(&sigmas.map(Some)),
        ..FitPoints::new(&[1.0; 5], &depths)
    };
    let found = fit(&points, &FitConfig::default(), None).unwrap();
    let square = found.noise();
    let weights = sigmas.map(|s| 1.0 / (square + f64::from(s).powi(2)));
    let pairs = depths.iter().zip(weights);
    let mean =
        pairs.clone().map(|(d, w)| w * f64::from(*d)).sum::<f64>() / weights.iter().sum::<f64>();
    assert!((found.weights[0] - mean).abs() < 1e-6);
    let squares: f64 = pairs.map(|(d, w)| w * (f64::from(*d) - mean).powi(2)).sum();
    assert!((squares - 4.0).abs() < 1e-4, "{squares}");
}

/// Problems with conditions from 1 to 1e12, 1 to 5000 points, repeated points, constant and
/// zero columns, zero rows.
fn problem(seed: u64) -> (Vec<f32>, Vec<f32>) {
    let mut rng = Rng::stream(seed, &["problem"]);
    let k = 1 + rng.below(16) as usize;
    let n = 1
        + (5000.0_f32.powf(rng.unit()) as usize).min(if seed.is_multiple_of(50) {
            5000
        } else {
            300
        });
    let condition = 10.0_f32.powf(12.0 * rng.unit());
    let mut bases = Vec::with_capacity(n * k);
    for _ in 0..n {
        for j in 0..k {
            let share = j as f32 / k.max(2) as f32;
            bases.push(if j == 0 {
                1.0
            } else {
                rng.normal() * condition.powf(-share)
            });
        }
    }
    let mut depths: Vec<f32> = (0..n).map(|_| 0.1 + 10.0 * rng.unit()).collect();
    match rng.below(5) {
        0 => {
            let half = n / 2;
            bases.copy_within(0..half * k, (n - half) * k);
            depths.copy_within(0..half, n - half);
        }
        1 => bases.chunks_exact_mut(k).for_each(|row| row[k - 1] = 1.0),
        2 => bases.chunks_exact_mut(k).for_each(|row| row[k - 1] = 0.0),
        3 => bases[..n / 2 * k].fill(0.0),
        _ => {}
    }
    (bases, depths)
}

#[test]
fn ten_thousand_problems_have_finite_answers() {
    let finite = |fit: &Fit, bases: &[f32]| {
        let leverages = fit.leverages(bases);
        // Points that are met whatever they are have no leave-one-out error.
        let pairs = fit.leave_one_out(&leverages).into_iter().zip(&leverages);
        let left_out = pairs.filter(|(_, h)| 1.0 - **h >= 1e-3);
        let left_out = left_out.map(|(error, _)| error).collect();
        let all = [
            &fit.weights,
            &fit.residuals,
            &fit.point_weights,
            &leverages,
            &left_out,
        ];
        all.iter().all(|v| v.iter().all(|v| v.is_finite()))
            && fit.spreads(bases).iter().all(|v| v.is_finite())
    };
    for seed in 0..10_000 {
        let (bases, depths) = problem(seed);
        let config = match seed % 7 {
            0 | 1 => FitConfig::default(),
            2 => FitConfig {
                ridge: 1e-6,
                ..FitConfig::default()
            },
            3 => FitConfig {
                prior: PriorKind::Flat,
                lambda: Lambda::Gcv,
                ..FitConfig::default()
            },
            4 => FitConfig {
                robust: Some(Robust::default()),
                ..FitConfig::default()
            },
            _ => FitConfig {
                prior: PriorKind::Flat,
                ..FitConfig::default()
            },
        };
        let fit = fit(&FitPoints::new(&bases, &depths), &config, None);
        let fit = fit.unwrap_or_else(|e| panic!("problem {seed}: {e}"));
        assert!(finite(&fit, &bases), "problem {seed}");
        let k = bases.len() / depths.len();
        assert!(
            fit.rank <= k.min(depths.len()) || config.ridge > 0.0 || fit.lambda.is_some(),
            "problem {seed}"
        );
        // No fit is worse at the points than the mean of the depths, which the first function
        // offers.
        if config == FitConfig::default() && bases.chunks_exact(k).all(|row| row[0] == 1.0) {
            let mean = depths.iter().sum::<f32>() / depths.len() as f32;
            let spread: f64 = depths.iter().map(|d| f64::from(d - mean).powi(2)).sum();
            assert!(
                fit.rms().powi(2) * depths.len() as f64 <= spread * (1.0 + 1e-6) + 1e-9,
                "problem {seed}"
            );
        }
    }
}

#[test]
fn moments_of_two_sets_of_points_add() {
    let prior = prior(5, 3, UNKNOWN);
    let (bases, depths) = scene(&prior, 300, 0.1, 0);
    let values: Vec<f64> = depths.iter().map(|&d| f64::from(d)).collect();
    let of = |from: usize, to: usize| {
        Problem::new(
            &bases[from * 5..to * 5],
            &values[from..to],
            &vec![1.0; to - from],
        )
        .moments()
    };
    let (whole, first, second) = (of(0, 300), of(0, 120), of(120, 300));
    let sum = &first.normal + &second.normal;
    assert!((&whole.normal - sum).norm_l2() < 1e-10 * whole.normal.norm_l2());
    assert_eq!(whole.count, first.count + second.count);
    assert!((whole.square - first.square - second.square).abs() < 1e-9 * whole.square);
}
