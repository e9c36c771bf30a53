//! The outlier test, against points whose errors are known.

use super::mixture::{Predict, Predictions, TestedPoints, rounds_after_rough, test_outliers};
use crate::error::Result;
use crate::fit::{
    Affinities, BasisValues, CosineBasis, FieldGeometry, FitConfig, FitMethod, FitPoints,
    JointConfig, Lambda, Loss, NoisePrior, Prior, PriorKind, Robust, fit, inlier_posteriors,
};
use lsdc_rng::Rng;

/// Predictions that do not depend on other points.
struct Known(Predictions);

impl Predict for Known {
    fn predict(&self, _: &[f64]) -> Result<Predictions> {
        Ok(self.0.clone())
    }
}

const COUNT: usize = 2000;

/// Errors of points, of which every tenth is wrong, about predictions of different variances.
fn errors() -> (Vec<f64>, Vec<f64>) {
    let mut rng = Rng::stream(3, &["mixture"]);
    let mut normal = || f64::from(rng.normal());
    let errors = (0..COUNT).map(|i| {
        let deviation = if i % 2 == 0 { 0.01 } else { 0.04 };
        // Student's t of 3 degrees of freedom: a normal over the root of the mean of three squares.
        let value = normal();
        let mean = (0..3).map(|_| normal().powi(2)).sum::<f64>() / 3.0;
        let right = deviation * value / mean.sqrt();
        if i % 10 == 3 { 0.8 * normal() } else { right }
    });
    let deviations = (0..COUNT).map(|i| if i % 2 == 0 { 0.01 } else { 0.04 });
    (errors.collect(), deviations.collect())
}

#[test]
fn probabilities_are_those_of_the_two_kinds_that_were_drawn() {
    let (errors, deviations) = errors();
    let points = TestedPoints {
        values: errors.iter().map(|e| 5.0 + e).collect(),
        noise: vec![1e-6; COUNT],
        places: None,
        unit: 5.0,
    };
    let found = test_outliers(
        &points,
        &points.noise,
        &Known(Predictions {
            errors: errors.clone(),
            variances: deviations.iter().map(|d| d * d).collect(),
        }),
    )
    .unwrap()
    .posteriors();
    // Bayes' rule with the densities that the errors were drawn from.
    let mut worst: f64 = 0.0;
    let mut off = 0.0;
    for ((error, deviation), found) in errors.iter().zip(&deviations).zip(&found) {
        let z = error / deviation;
        let tau = std::f64::consts::TAU;
        let right = 0.9 * 4.0 / (3.0_f64.sqrt() * tau * (1.0 + z * z / 3.0).powi(2)) / deviation;
        let wrong = 0.1 * (-0.5 * (error / 0.8).powi(2)).exp() / (0.8 * tau.sqrt());
        let expected = right / (right + wrong);
        worst = worst.max((found.p_inlier - expected).abs());
        off += (found.p_inlier - expected).abs() / COUNT as f64;
    }
    // The assumed parameters of errors are estimated from them.
    assert!(off < 0.02, "{off}");
    assert!(worst < 0.3, "{worst}");
}

#[test]
fn points_that_agree_with_their_neighbours_may_lie_on_something_hidden() {
    // A wall, seen by points 4 apart; of the 400, 60 are wrong, and 9 lie on a box before it.
    let mut rng = Rng::stream(4, &["hidden"]);
    let places: Vec<[f64; 2]> = (0..400)
        .map(|i| [(i % 20 * 4) as f64, (i / 20 * 4) as f64])
        .collect();
    let on_box = |i: usize| (8..11).contains(&(i % 20)) && (8..11).contains(&(i / 20));
    let wrong = |i: usize| i % 7 == 1 && !on_box(i);
    let errors: Vec<f64> = (0..400)
        .map(|i| {
            let noise = 0.01 * f64::from(rng.normal());
            let error = f64::from(rng.range(-1.0, 1.0));
            match (on_box(i), wrong(i)) {
                (true, _) => noise - 0.5,
                (_, true) => error,
                _ => noise,
            }
        })
        .collect();
    let points = TestedPoints {
        values: errors.iter().map(|e| 3.0 + e).collect(),
        noise: vec![1e-6; 400],
        places: Some(places),
        unit: 3.0,
    };
    let known = |variance: f64| {
        Known(Predictions {
            errors: errors.clone(),
            variances: vec![variance; 400],
        })
    };
    let found = test_outliers(&points, &points.noise, &known(1e-4))
        .unwrap()
        .posteriors();
    let trust = |which: &dyn Fn(usize) -> bool| {
        let some = (0..400).filter(|&i| which(i)).map(|i| found[i].p_inlier);
        some.clone().sum::<f64>() / some.count() as f64
    };
    assert!(trust(&on_box) > 0.5, "{}", trust(&on_box));
    assert!(trust(&|i| wrong(i) && errors[i].abs() > 0.1) < 0.1);
    assert!(trust(&|i| !wrong(i) && !on_box(i)) > 0.95);
    // The result depends on neither position nor unit.
    let far = TestedPoints {
        values: points.values.iter().map(|v| 8.0 * v).collect(),
        unit: 24.0,
        ..points.clone()
    };
    let scaled = Known(Predictions {
        errors: errors.iter().map(|e| 8.0 * e).collect(),
        variances: vec![1e-4; 400],
    });
    for (one, other) in found.iter().zip(
        test_outliers(&far, &far.noise, &scaled)
            .unwrap()
            .posteriors(),
    ) {
        assert!((one.p_inlier - other.p_inlier).abs() < 1e-9);
        assert!((8.0 * one.error - other.error).abs() < 1e-9);
    }
}

const HEIGHT: usize = 40;
const WIDTH: usize = 60;

/// A slope with a step at the middle column, which the image shows, and a share of wrong points.
struct Slope {
    affinities: Affinities,
    bases: Vec<f32>,
    depths: Vec<f32>,
    clean: Vec<f32>,
    places: Vec<[f64; 2]>,
}

impl Slope {
    fn new(count: usize, share: f32) -> Self {
        let mut rng = Rng::stream(9, &["slope"]);
        let strengths = (0..2 * HEIGHT * WIDTH).map(|i| {
            // Right of the column before the step.
            if i % 2 == 0 && i / 2 % WIDTH == WIDTH / 2 - 1 {
                1e-4
            } else {
                1.0
            }
        });
        let strengths: Vec<f32> = strengths.collect();
        let mut pixels: Vec<usize> = (0..HEIGHT * WIDTH).collect();
        rng.choose(&mut pixels, count);
        // Pixels repeat if there are more points.
        let pixels: Vec<usize> = pixels.into_iter().cycle().take(count).collect();
        let within = |p: usize, rng: &mut Rng| {
            let [x, y] = [p % WIDTH, p / WIDTH].map(|v| v as f64);
            let several = count > HEIGHT * WIDTH;
            let off = if several { rng.range(-0.4, 0.4) } else { 0.0 };
            [x, y + f64::from(off)]
        };
        let places: Vec<[f64; 2]> = pixels.iter().map(|&p| within(p, &mut rng)).collect();
        let depth = |&[x, y]: &[f64; 2]| {
            let step = if x < (WIDTH / 2) as f64 { 0.0 } else { 1.0 };
            (2.0 + 0.01 * x + 0.005 * y + step) as f32
        };
        let clean: Vec<f32> = places.iter().map(depth).collect();
        let depths = clean.iter().map(|depth| {
            let noise = 0.002 * rng.normal();
            let off = if rng.chance(share) {
                rng.range(0.3, 1.5)
            } else {
                0.0
            };
            depth + noise + off
        });
        Self {
            affinities: Affinities::new((HEIGHT, WIDTH), &strengths).unwrap(),
            bases: CosineBasis::up_to(1.0).append_to(
                &vec![1.0; count],
                1,
                (HEIGHT, WIDTH),
                &places,
            ),
            depths: depths.collect(),
            clean,
            places,
        }
    }

    fn points(&self) -> FitPoints<'_> {
        FitPoints {
            bases: BasisValues::AtPoints(&self.bases),
            guides: 0,
            depths: &self.depths,
            deviations: None,
            places: Some(&self.places),
            geometry: Some(FieldGeometry {
                affinities: &self.affinities,
                size: (HEIGHT, WIDTH),
                upsampling: None,
                transient: false,
            }),
        }
    }

    fn wrong(&self, i: usize) -> bool {
        (self.depths[i] - self.clean[i]).abs() > 0.1
    }
}

fn joint(robust: Option<Loss>) -> FitConfig {
    FitConfig {
        method: FitMethod::Joint,
        joint: JointConfig {
            cosines: 1.0,
            ..JointConfig::default()
        },
        prior: PriorKind::Learned,
        lambda: Lambda::Fixed(0.01),
        robust: robust.map(Robust::new),
        ..FitConfig::default()
    }
}

fn prior() -> Prior {
    let noise = NoisePrior {
        mean: 0.0,
        deviation: None,
        equivalent_points: 0.0,
    };
    Prior::new(&[1.0], &[0.1], noise).unwrap()
}

#[test]
fn wrong_points_are_found_and_lose_their_influence() {
    for count in [150, 1200, 24_000, 40_000] {
        let slope = Slope::new(count, 0.2);
        let posteriors = inlier_posteriors(&slope.points(), &joint(None), Some(&prior())).unwrap();
        let wrong = (0..count).filter(|&i| slope.wrong(i)).count();
        let called: Vec<usize> = (0..count)
            .filter(|&i| posteriors[i].p_inlier < 0.5)
            .collect();
        let found = called.iter().filter(|&&i| slope.wrong(i)).count();
        assert!(found as f64 >= 0.95 * wrong as f64, "{found} of {wrong}");
        assert!(
            found as f64 >= 0.95 * called.len() as f64,
            "{found} of {}",
            called.len()
        );
        // Off by what the others do not explain.
        for &i in called.iter().filter(|&&i| slope.wrong(i)) {
            let expected = f64::from(slope.depths[i] - slope.clean[i]);
            assert!(
                (posteriors[i].error - expected).abs() < 0.3,
                "{} {expected}",
                posteriors[i].error
            );
        }
        let error = |loss: Option<Loss>| {
            let fit = fit(&slope.points(), &joint(loss), Some(&prior())).unwrap();
            let squares = (0..count).map(|i| {
                let fitted = f64::from(slope.depths[i]) - fit.residuals[i];
                (fitted - f64::from(slope.clean[i])).powi(2)
            });
            (squares.sum::<f64>() / count as f64).sqrt()
        };
        let (plain, auto) = (error(None), error(Some(Loss::Auto)));
        assert!(auto < 0.1 * plain, "{auto} {plain}");
    }
}

#[test]
fn many_wrong_points_are_judged_in_more_rounds() {
    for count in [15_000, 30_000, 100_000] {
        let rounds = |wrong: usize| {
            let right: Vec<f64> = (0..count).map(|i| f64::from(i % 10 >= wrong)).collect();
            rounds_after_rough(&right)
        };
        assert!(rounds(3) >= 2 * rounds(1), "{count}");
    }
}

#[test]
fn a_single_wrong_point_is_found_however_far_off_it_is() {
    for off in [0.5, 1.5, 10.0, 1e4] {
        let mut slope = Slope::new(150, 0.0);
        slope.depths[40] += off;
        let posteriors = inlier_posteriors(&slope.points(), &joint(None), Some(&prior())).unwrap();
        let called: Vec<usize> = (0..150).filter(|&i| posteriors[i].p_inlier < 0.5).collect();
        assert_eq!(called, [40], "{off}");
    }
}

#[test]
fn a_wrong_point_on_a_flat_wall_is_found() {
    for (noise, off) in [(0.0, 4.0), (1e-4, 1.0), (0.01, 4.0)] {
        let mut slope = Slope::new(50, 0.0);
        slope.affinities =
            Affinities::new((HEIGHT, WIDTH), &vec![1.0; 2 * HEIGHT * WIDTH]).unwrap();
        let mut rng = Rng::stream(9, &["wall"]);
        slope.depths = (0..50).map(|_| 2.0 + noise * rng.normal()).collect();
        slope.depths[7] += off;
        let posteriors = inlier_posteriors(&slope.points(), &joint(None), Some(&prior())).unwrap();
        let called: Vec<usize> = (0..50).filter(|&i| posteriors[i].p_inlier < 0.5).collect();
        assert_eq!(called, [7], "{noise} {off}");
    }
}

#[test]
fn right_points_are_trusted() {
    let slope = Slope::new(200, 0.0);
    let posteriors = inlier_posteriors(&slope.points(), &joint(None), Some(&prior())).unwrap();
    let trust = posteriors.iter().map(|found| found.p_inlier).sum::<f64>() / 200.0;
    assert!(trust > 0.97, "{trust}");
    assert!(posteriors.iter().all(|found| found.p_inlier > 0.5));
}

#[test]
fn neither_unit_nor_order_of_the_points_matters() {
    // Few points, and so many that a sample predicts the others.
    for count in [150, 33_000] {
        is_one_whatever_unit_and_order(count);
    }
}

fn is_one_whatever_unit_and_order(count: usize) {
    let slope = Slope::new(count, 0.2);
    let weights = |slope: &Slope| {
        let fit = fit(&slope.points(), &joint(Some(Loss::Auto)), Some(&prior())).unwrap();
        (fit.point_weights, fit.weights)
    };
    let (kept, solution) = weights(&slope);
    let mut far = Slope::new(count, 0.2);
    far.depths.iter_mut().for_each(|d| *d *= 8.0);
    let (scaled, larger) = weights(&far);
    for (one, other) in kept.iter().zip(&scaled) {
        assert!((one - other).abs() < 1e-9);
    }
    for (one, other) in solution.iter().zip(&larger) {
        assert!((8.0 * one - other).abs() < 1e-8 * other.abs().max(1.0));
    }
    let turn = |i: usize| (i * 7 + 3) % count;
    let mut turned = Slope::new(count, 0.2);
    let stride = slope.bases.len() / count;
    for i in 0..count {
        turned.depths[i] = slope.depths[turn(i)];
        turned.places[i] = slope.places[turn(i)];
        turned.bases[i * stride..][..stride]
            .copy_from_slice(&slope.bases[turn(i) * stride..][..stride]);
    }
    let (other, same) = weights(&turned);
    assert_eq!(solution, same);
    for (i, weight) in other.into_iter().enumerate() {
        assert_eq!(weight, kept[turn(i)]);
    }
}

#[test]
fn a_line_without_a_field_forgets_wrong_points() {
    let mut rng = Rng::stream(5, &["line"]);
    let (mut bases, mut depths) = (Vec::new(), Vec::new());
    for i in 0..400_u16 {
        let x = f32::from(i) / 400.0;
        let raised = if rng.chance(0.3) {
            1.0 + rng.unit()
        } else {
            0.0
        };
        bases.extend([1.0, x]);
        depths.push(2.0 + 3.0 * x + 0.01 * rng.normal() + raised);
    }
    let config = FitConfig {
        robust: Some(Robust::new(Loss::Auto)),
        ..FitConfig::default()
    };
    let found = fit(&FitPoints::new(&bases, &depths), &config, None).unwrap();
    for (found, expected) in found.weights.iter().zip([2.0, 3.0]) {
        assert!((found - expected).abs() < 0.01, "{found}");
    }
}
