//! The public interface, as used by an embedding program.

#![cfg(feature = "weights")]
#![allow(clippy::unwrap_used)]

use lsdc_core::network::{Basis, CpuNetwork, Forward, Network};
use lsdc_core::settings::{FitConfig, FitMethod, Loss, PriorKind, Robust};
use lsdc_core::{
    Camera, Channels, Cloud, Completer, DepthMap, Error, FitError, Image, Lens, Observation,
    Observations, Result, Scene, Weights,
};
use lsdc_kernels::simd::Level;
use std::process::Command;
use std::sync::{Arc, LazyLock};

static COMPLETER: LazyLock<Completer> =
    LazyLock::new(|| Completer::new(&Weights::builtin_small()).unwrap());

/// An image with edges and gradients.
fn colours(width: usize, height: usize) -> Vec<u8> {
    let colour = |i: usize| {
        let (x, y) = (i % width, i / width);
        let block = if (x * 5 / width + y * 4 / height).is_multiple_of(2) {
            70
        } else {
            0
        };
        [
            x * 150 / width + block,
            y * 150 / height + block,
            90 + block,
        ]
        .map(|v| v as u8)
    };
    (0..width * height).flat_map(colour).collect()
}

fn scene_of(completer: &Completer, width: usize, height: usize) -> Scene {
    let rgb = colours(width, height);
    let image = Image::new(width, height, Channels::Rgb, &rgb).unwrap();
    completer.scene(&image).unwrap()
}

/// A plane with a step, at positions between pixels.
fn observations(width: usize, height: usize, count: usize) -> Observations {
    let share = |i: usize, by: f64| (i as f64 * by).fract();
    let observation = |i: usize| {
        let (u, v) = (
            share(i, 0.754_877_666) * width as f64 - 0.5,
            share(i, 0.569_840_291) * height as f64 - 0.5,
        );
        let step = if u * 2.0 > width as f64 { 0.4 } else { 0.0 };
        let depth = 2.0 + 0.8 * u / width as f64 + 0.5 * v / height as f64 + step;
        Observation {
            u,
            v,
            depth: depth as f32,
            sigma: None,
        }
    };
    (0..count).map(observation).collect()
}

fn with(completer: &Completer, change: impl FnOnce(&mut FitConfig)) -> Completer {
    let mut fit = *completer.fit_config();
    change(&mut fit);
    completer.with_fit(fit)
}

/// Interpolates the written map bilinearly between the centres of its pixels.
fn read(map: &DepthMap, u: f64, v: f64) -> f64 {
    let between = |place: f64, length: usize| {
        let place = place.clamp(0.0, (length - 1) as f64);
        (
            place as usize,
            (place as usize + 1).min(length - 1),
            place.fract(),
        )
    };
    let (left, right, across) = between(u, map.width());
    let (top, bottom, down) = between(v, map.height());
    let at = |x, y| f64::from(map.at(x, y));
    let along = |y| at(left, y) * (1.0 - across) + at(right, y) * across;
    along(top) * (1.0 - down) + along(bottom) * down
}

/// At 640x480 the network works at 304x228: residuals must be those of the map that is written. More than 1000 points are
/// fitted from a sample.
#[test]
fn residuals_are_those_of_the_written_map() {
    for (width, height, count) in [(640, 480, 300), (304, 228, 1500), (160, 120, 1500)] {
        let scene = scene_of(&COMPLETER, width, height);
        // On pixel centres, where the map has values.
        let given: Observations = observations(width, height, count)
            .iter()
            .map(|p| Observation {
                u: p.u.round().max(0.0),
                v: p.v.round().max(0.0),
                ..*p
            })
            .collect();
        let completion = scene.complete(&given).unwrap();
        let depth = completion.depth().unwrap();
        for (point, residual) in given.iter().zip(completion.residuals()) {
            let written = f64::from(depth.at(point.u as usize, point.v as usize));
            let expected = f64::from(point.depth) - written;
            assert!((residual - expected).abs() < 2e-5, "{residual} {expected}");
        }
        let squares: f64 = completion.residuals().iter().map(|r| r * r).sum();
        let rms = (squares / count as f64).sqrt();
        assert!((completion.report().residual - rms).abs() < 1e-12);
    }
}

#[test]
fn places_between_pixels_are_read_as_maps_of_any_size_are() {
    let scene = scene_of(&COMPLETER, 96, 72);
    let completion = scene.complete(&observations(96, 72, 120)).unwrap();
    // The pixel centres of a map of four times the size are between pixels of the image.
    let large = completion.depth_at(384, 288).unwrap();
    let places: Vec<[f64; 2]> = (0..200)
        .map(|i| [(i * 37 % 384) as f64, (i * 53 % 288) as f64])
        .map(|[x, y]| [(x + 0.5) / 4.0 - 0.5, (y + 0.5) / 4.0 - 0.5])
        .collect();
    let values = completion.at(&places).unwrap();
    for (place, value) in places.iter().zip(values) {
        let x = ((place[0] + 0.5) * 4.0 - 0.5).round() as usize;
        let y = ((place[1] + 0.5) * 4.0 - 0.5).round() as usize;
        assert!((value - large.at(x, y)).abs() < 2e-5 * value, "{place:?}");
    }
    assert!(completion.at(&[[-0.6, 3.0]]).is_err());
    assert!(completion.at(&[[3.0, f64::NAN]]).is_err());
    assert!(completion.at(&[]).unwrap().is_empty());
}

/// A map of an image larger than the working size is interpolated along its edges.
#[test]
fn maps_of_larger_images_and_their_places_are_read_alike() {
    let scene = scene_of(&COMPLETER, 500, 380);
    let given = observations(500, 380, 150);
    let completion = scene.complete(&given).unwrap();
    for (width, height) in [(500, 380), (650, 410), (120, 90)] {
        let map = completion.depth_at(width, height).unwrap();
        let pixels: Vec<_> = (0..300)
            .map(|i| (i * 37 % width, i * 53 % height))
            .collect();
        let within =
            |x: usize, from: usize, to: usize| (x as f64 + 0.5) * to as f64 / from as f64 - 0.5;
        let place = |&(x, y): &(usize, usize)| [within(x, width, 500), within(y, height, 380)];
        let places: Vec<[f64; 2]> = pixels.iter().map(place).collect();
        let values = completion.at(&places).unwrap();
        for ((x, y), value) in pixels.into_iter().zip(values) {
            assert!(
                (value - map.at(x, y)).abs() < 2e-5 * value,
                "{width}: {x} {y}"
            );
        }
    }
    let near = completion.depth().unwrap();
    let far = given.iter().map(|p| Observation {
        depth: 8.0 * p.depth,
        ..*p
    });
    let far = scene.complete(&far.collect()).unwrap().depth().unwrap();
    for (near, far) in near.values().iter().zip(far.values()) {
        assert!((8.0 * near - far).abs() <= 2e-4 * far.abs(), "{near} {far}");
    }
}

/// Every point at its exact position: an offset of half a pixel would shift the map.
#[test]
fn points_are_observed_where_they_are() {
    let ramp = |u: f64| (2.0 + 0.02 * u) as f32;
    let flat = vec![128_u8; 3 * 200 * 150];
    let image = Image::new(200, 150, Channels::Rgb, &flat).unwrap();
    let field = with(&COMPLETER, |fit| fit.method = FitMethod::Field);
    let scene = field.scene(&image).unwrap();
    let mut given = Observations::new();
    for v in (0..150).step_by(3) {
        for u in (0..200).step_by(3) {
            let place = f64::from(u) + 0.37;
            given.add(place, f64::from(v) - 0.21, ramp(place));
        }
    }
    let depth = scene.complete(&given).unwrap().depth().unwrap();
    let mut worst = 0.0_f64;
    for y in 20..130 {
        for x in 20..180 {
            // In pixels, by the slope of the ramp.
            let off = (f64::from(depth.at(x, y)) - f64::from(ramp(x as f64))) / 0.02;
            worst = worst.max(off.abs());
        }
    }
    assert!(worst < 0.15, "{worst} pixels");
}

#[test]
fn scaling_depths_scales_everything() {
    let scene = scene_of(&COMPLETER, 64, 48);
    let given = observations(64, 48, 60);
    let near = scene.complete(&given).unwrap();
    for factor in [1e-6_f32, 0.125, 4.0, 1e6] {
        let scaled = given.iter().map(|p| Observation {
            depth: factor * p.depth,
            ..*p
        });
        let far = scene.complete(&scaled.collect()).unwrap();
        let pairs = [
            (near.depth().unwrap(), far.depth().unwrap()),
            (
                near.standard_deviation().unwrap(),
                far.standard_deviation().unwrap(),
            ),
        ];
        for (near, far) in pairs {
            for (near, far) in near.values().iter().zip(far.values()) {
                assert!(
                    (near * factor - far).abs() <= 2e-4 * far.abs(),
                    "{factor}: {near} {far}"
                );
            }
        }
    }
}

#[test]
fn what_is_left_out_is_counted() {
    let scene = scene_of(&COMPLETER, 64, 48);
    let mut given = observations(64, 48, 20);
    for (u, v, depth) in [
        (10.0, 10.0, 0.0),
        (10.0, 10.0, -1.0),
        (10.0, 10.0, f32::NAN),
        (10.0, 10.0, f32::INFINITY),
        (f64::NAN, 10.0, 1.0),
        (10.0, f64::INFINITY, 1.0),
        (63.5, 10.0, 1.0),
        (-0.51, 10.0, 1.0),
        (10.0, 48.0, 1.0),
    ] {
        given.add(u, v, depth);
    }
    given.push(Observation {
        u: 3.0,
        v: 3.0,
        depth: 2.0,
        sigma: Some(0.0),
    });
    let completion = scene.complete(&given).unwrap();
    let report = completion.report();
    assert_eq!(
        (report.given, report.used, report.invalid, report.outside),
        (30, 21, 6, 3)
    );
    // A standard deviation of 0 is unknown, as are all others.
    assert_eq!(report.without_deviation, 0);
    let used = |values: Vec<f64>| values.iter().filter(|v| v.is_finite()).count();
    assert_eq!(used(completion.residuals()), 21);
    assert_eq!(used(completion.leave_one_out()), 21);
    assert!(completion.residuals()[20..29].iter().all(|v| v.is_nan()));

    let nothing: Observations = given.iter().skip(20).take(9).copied().collect();
    let error = scene.complete(&nothing).unwrap_err();
    let expected = FitError::NoObservations {
        given: 9,
        invalid: 6,
        outside: 3,
    };
    assert!(
        matches!(&error, Error::Fit(found) if *found == expected),
        "{error}"
    );
    assert!(error.hint().is_some());
    assert!(scene.complete(&Observations::new()).is_err());
}

fn with_sigma(given: &Observations, sigma: impl Fn(usize) -> Option<f32>) -> Observations {
    let points = given.iter().enumerate();
    let points = points.map(|(i, p)| Observation {
        sigma: sigma(i),
        ..*p
    });
    points.collect()
}

#[test]
fn points_without_a_deviation_among_others_are_counted() {
    let scene = scene_of(&COMPLETER, 64, 48);
    let given = with_sigma(&observations(64, 48, 21), |i| (i == 20).then_some(0.1));
    assert_eq!(
        scene.complete(&given).unwrap().report().without_deviation,
        20
    );
}

/// The same rule for every input: a standard deviation that is 0, negative or not finite is unknown.
#[test]
fn unusable_deviations_are_unknown() {
    let scene = scene_of(&COMPLETER, 64, 48);
    let given = observations(64, 48, 21);
    let map = |sigma: Option<f32>| {
        let points = with_sigma(&given, |i| if i < 5 { sigma } else { Some(0.1) });
        let completion = scene.complete(&points).unwrap();
        assert_eq!(completion.report().without_deviation, 5);
        completion.depth().unwrap()
    };
    let unknown = map(None);
    for sigma in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        assert_eq!(map(Some(sigma)), unknown, "{sigma}");
    }
    // They do not count as exact measurements.
    let least = |sigma: Option<f32>| {
        let points = with_sigma(&given, |i| if i < 5 { sigma } else { Some(0.1) });
        let weights = scene.complete(&points).unwrap().point_weights();
        weights[..5].iter().copied().fold(f64::INFINITY, f64::min)
    };
    assert!(least(None) <= 0.5 && least(Some(1e-9)) > 0.99);
}

/// The depths of a wall with a step, at most pixels of an image larger than the grid.
fn dense_depths(width: usize, height: usize) -> Observations {
    let mut points = Observations::new();
    for y in 0..height {
        for x in 0..width {
            let wave = 0.05 * ((x * 7 + y * 3) as f32 * 0.9).sin();
            let step = if x > width / 2 { 0.6 } else { 0.0 };
            if (x * 13 + y * 7) % 5 > 0 {
                points.add(x as f64, y as f64, 1.5 + 0.002 * x as f32 + step + wave);
            }
        }
    }
    points
}

/// For dense input, leave-one-out errors are those of the written map, which follows each depth. They are first-order
/// approximations, with errors of a third of the noise that no neighbour shares.
#[test]
fn leave_one_out_errors_of_dense_depths_are_those_of_maps_without_the_point() {
    let (width, height) = (400, 300);
    let scene = scene_of(&COMPLETER, width, height);
    let given = dense_depths(width, height);
    let completion = scene.complete(&given).unwrap();
    assert!(completion.report().residual < 1e-4);
    let found = completion.leave_one_out();
    let (mut squares, mut differences) = (0.0, 0.0);
    for i in (1000..given.len()).step_by(given.len() / 6) {
        let others = given.iter().enumerate().filter(|(j, _)| *j != i);
        let others: Observations = others.map(|(_, point)| *point).collect();
        let point = given.as_slice()[i];
        let without = scene.complete(&others).unwrap();
        let depth = without.at(&[[point.u, point.v]]).unwrap()[0];
        let expected = f64::from(point.depth - depth);
        squares += expected.powi(2);
        differences += (found[i] - expected).powi(2);
    }
    assert!(
        differences.sqrt() < 0.4 * squares.sqrt(),
        "{} {}",
        differences.sqrt(),
        squares.sqrt()
    );
}

/// Standard deviations are in the unit of the depths: precise measurements are followed, imprecise ones are smoothed, and the
/// result is then less certain. Depths and deviations times ten give ten times the result.
#[test]
fn deviations_of_points_are_absolute() {
    let scene = scene_of(&COMPLETER, 96, 72);
    let mut given: Vec<Observation> = observations(96, 72, 150).iter().copied().collect();
    for (i, point) in given.iter_mut().enumerate() {
        point.depth += if i % 2 == 0 { 0.2 } else { -0.2 };
    }
    let given: Observations = given.into_iter().collect();
    let none = scene.complete(&with_sigma(&given, |_| None)).unwrap();
    let of = |sigma: f32| {
        scene
            .complete(&with_sigma(&given, |_| Some(sigma)))
            .unwrap()
    };
    let [tiny, precise, rough, useless] = [1e-9, 1e-3, 0.3, 1e6].map(of);
    let rms = |c: &lsdc_core::Completion| c.report().residual;
    assert!((rms(&tiny) / rms(&none) - 1.0).abs() < 1e-3);
    assert!(
        rms(&precise) < 0.1 && rms(&rough) > 0.15,
        "{} {}",
        rms(&precise),
        rms(&rough)
    );
    assert!(
        useless
            .depth()
            .unwrap()
            .values()
            .iter()
            .all(|d| d.is_finite() && *d > 0.0)
    );
    let scaled: Observations = with_sigma(&given, |_| Some(3.0))
        .iter()
        .map(|p| Observation {
            depth: 10.0 * p.depth,
            ..*p
        })
        .collect();
    let scaled = scene.complete(&scaled).unwrap().depth().unwrap();
    let pairs = scaled
        .values()
        .iter()
        .zip(rough.depth().unwrap().values().to_vec());
    for (scaled, depth) in pairs {
        assert!((scaled / depth - 10.0).abs() < 1e-3);
    }
    // One precise point does not reduce the weights of others.
    let one = scene.complete(&with_sigma(&given, |i| {
        Some(if i == 7 { 1e-6 } else { 0.3 })
    }));
    let weights = one.unwrap().point_weights();
    assert!(
        (weights[7] - 1.0).abs() < 1e-3 && weights[8] > 1e-6,
        "{weights:?}"
    );
}

/// Student's t distribution with these degrees of freedom: the ratio of the bounds of 95.45 % and 68.27 %.
#[test]
fn intervals_grow_with_their_level() {
    let scene = scene_of(&COMPLETER, 96, 72);
    let completion = scene.complete(&observations(96, 72, 150)).unwrap();
    assert!((completion.interval(0.682_689_5).unwrap() - 1.0).abs() < 1e-6);
    let two = completion.interval(0.954_499_7).unwrap();
    match completion.freedom() {
        None => assert!((two - 2.0).abs() < 1e-4),
        Some(freedom) => assert!(freedom >= 1.0 && two > 2.0, "{two}"),
    }
    assert!(completion.interval(0.99).unwrap() > two);
    assert!(completion.interval(1.0).is_err() && completion.interval(f64::NAN).is_err());
}

/// A point with a large known deviation is not an outlier because of its error.
#[test]
fn outliers_are_judged_by_their_own_deviations() {
    let scene = scene_of(&COMPLETER, 96, 72);
    let mut given: Vec<Observation> = observations(96, 72, 150)
        .iter()
        .map(|p| Observation {
            sigma: Some(0.02),
            ..*p
        })
        .collect();
    given[40].depth += 1.0;
    let listed = |given: &[Observation]| {
        let completion = scene.complete(&given.iter().copied().collect()).unwrap();
        let found = completion.outliers().unwrap();
        found
            .iter()
            .map(|outlier| outlier.index)
            .collect::<Vec<_>>()
    };
    assert_eq!(listed(&given).first(), Some(&40), "the worst comes first");
    given[40].sigma = Some(2.0);
    assert!(!listed(&given).contains(&40));
}

#[test]
fn a_robust_fit_leaves_outliers_little_weight() {
    let robust = with(&COMPLETER, |fit| {
        fit.robust = Some(Robust::new(Loss::Cauchy));
    });
    let scene = scene_of(&robust, 96, 72);
    let mut given: Vec<Observation> = observations(96, 72, 150).iter().copied().collect();
    given[40].depth += 1.5;
    let completion = scene.complete(&given.iter().copied().collect()).unwrap();
    assert!(completion.point_weights()[40] < 0.05);
    let clean = given[40].depth - 1.5;
    let found = completion.at(&[[given[40].u, given[40].v]]).unwrap()[0];
    assert!((found - clean).abs() < 0.2, "{found} {clean}");
}

#[test]
fn the_next_frame_of_a_video_starts_from_the_one_before() {
    let scene = scene_of(&COMPLETER, 96, 72);
    let many = scene.complete(&observations(96, 72, 300)).unwrap();
    let few = observations(96, 72, 3);
    let error = |map: DepthMap| {
        let truth = many.depth().unwrap();
        let pairs = map.values().iter().zip(truth.values());
        let squares: f64 = pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum();
        (squares / truth.values().len() as f64).sqrt()
    };
    let alone = error(scene.complete(&few).unwrap().depth().unwrap());
    let near = scene.complete_near(&few, many.weights()).unwrap();
    let near = error(near.depth().unwrap());
    assert!(near < 0.9 * alone, "{near} {alone}");
    // Weights of other basis functions, and uninformative weights.
    let count = many.weights().len();
    for wrong in [
        vec![1.0],
        vec![1.0; count + 1],
        vec![0.0; count],
        vec![f64::NAN; count],
    ] {
        let error = scene.complete_near(&few, &wrong).unwrap_err();
        assert!(error.hint().is_some(), "{error}");
    }
}

#[test]
fn only_fits_with_the_learned_prior_are_drawn_towards_another() {
    let given = observations(96, 72, 50);
    let whole = scene_of(&COMPLETER, 96, 72).complete(&given).unwrap();
    let changes: [fn(&mut FitConfig); 3] = [
        |fit| fit.prior = PriorKind::Flat,
        |fit| (fit.method, fit.prior) = (FitMethod::Lse, PriorKind::None),
        |fit| fit.method = FitMethod::Field,
    ];
    for change in changes {
        let scene = scene_of(&with(&COMPLETER, change), 96, 72);
        let error = scene.complete_near(&given, whole.weights()).unwrap_err();
        let expected = FitError::NearWithoutPrior;
        assert!(
            matches!(&error, Error::Fit(found) if *found == expected),
            "{error}"
        );
    }
}

/// Threads that wait for a part of one result may steal a task that needs the same result.
#[test]
fn a_completion_can_be_asked_from_many_threads_at_once() {
    let scene = scene_of(&COMPLETER, 64, 48);
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(2)
        .build()
        .unwrap();
    for seed in 0..20 {
        let given = observations(64, 48, 30 + seed);
        let completion = scene.complete(&given).unwrap();
        let expected = scene
            .complete(&given)
            .unwrap()
            .standard_deviation()
            .unwrap();
        let ((deviation, _), _) = pool.install(|| {
            let ask = || rayon::join(|| completion.standard_deviation(), || completion.outliers());
            rayon::join(ask, || completion.leave_one_out())
        });
        assert_eq!(deviation.unwrap(), expected);
    }
}

/// A fit with as many functions as points interpolates any points.
#[test]
fn a_fit_that_meets_every_point_knows_nothing_of_its_errors() {
    let saturated = with(&COMPLETER, |fit| {
        (fit.method, fit.prior) = (FitMethod::Lse, PriorKind::None);
    });
    let completion = scene_of(&saturated, 96, 72)
        .complete(&observations(96, 72, 40))
        .unwrap();
    assert!(completion.report().residual < 1e-4);
    assert!(matches!(
        completion.standard_deviation().unwrap_err(),
        Error::Fit(FitError::TooFewPoints(_))
    ));
    assert_eq!(completion.leave_one_out_error(), None);
    assert!(
        completion
            .leave_one_out()
            .iter()
            .all(|error| error.is_nan())
    );
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    for (width, height) in [(160, 120), (500, 380)] {
        the_number_of_threads_changes_no_bit_of(width, height);
    }
}

fn the_number_of_threads_changes_no_bit_of(width: usize, height: usize) {
    let given = observations(width, height, 400);
    let on = |threads: usize| {
        let weights = Weights::builtin_small();
        let completer = Completer::builder(&weights)
            .threads(threads)
            .build()
            .unwrap();
        let completion = scene_of(&completer, width, height)
            .complete(&given)
            .unwrap();
        (
            completion.depth().unwrap(),
            completion.standard_deviation().unwrap(),
        )
    };
    let one = on(1);
    for threads in [2, 3, 7] {
        assert_eq!(one, on(threads), "{threads} threads");
    }
}

#[test]
fn a_pool_of_millions_of_threads_is_refused() {
    let weights = Weights::builtin_small();
    let error = Completer::builder(&weights)
        .threads(1 << 20)
        .build()
        .unwrap_err();
    assert!(matches!(error, Error::Settings(_)), "{error}");
}

#[test]
fn an_instruction_set_that_the_processor_lacks_is_refused() {
    // The variable is read once per process.
    if std::env::var("LSDC_SIMD").as_deref() != Ok("sse") {
        let name = "an_instruction_set_that_the_processor_lacks_is_refused";
        let run = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", name])
            .env("LSDC_SIMD", "sse")
            .output()
            .unwrap();
        let text = String::from_utf8_lossy(&run.stdout);
        assert!(run.status.success() && text.contains("1 passed"), "{text}");
        return;
    }
    let error = Completer::new(&Weights::builtin_small()).unwrap_err();
    assert!(error.to_string().ends_with(": `sse`"), "{error}");
    assert!(error.hint().unwrap().contains("`portable`"));
}

#[test]
fn a_pool_of_the_caller_is_used() {
    let pool = Arc::new(
        rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .build()
            .unwrap(),
    );
    let weights = Weights::builtin_small();
    let completer = Completer::builder(&weights)
        .thread_pool(pool)
        .build()
        .unwrap();
    let scene = scene_of(&completer, 64, 48);
    let given = observations(64, 48, 30);
    let expected = scene_of(&COMPLETER, 64, 48)
        .complete(&given)
        .unwrap()
        .depth()
        .unwrap();
    assert_eq!(scene.complete(&given).unwrap().depth().unwrap(), expected);
}

#[test]
fn buffers_of_the_caller_are_filled_row_by_row() {
    let completion = scene_of(&COMPLETER, 20, 15)
        .complete(&observations(20, 15, 9))
        .unwrap();
    let map = completion.depth().unwrap();
    let mut buffer = vec![-1.0; 24 * 15];
    completion.write_depth(20, 15, 24, &mut buffer).unwrap();
    for (row, expected) in buffer.chunks(24).zip(map.values().chunks(20)) {
        assert_eq!(&row[..20], expected);
        assert_eq!(row[20..], [-1.0; 4]);
    }
    let mut short = vec![-1.0; 24 * 14 + 19];
    assert!(completion.write_depth(20, 15, 24, &mut short).is_err());
    assert!(completion.write_depth(20, 15, 19, &mut buffer).is_err());
    assert!(completion.write_depth(0, 15, 24, &mut buffer).is_err());
    assert!(short.iter().all(|v| *v == -1.0));
    assert!(completion.depth_at(1 << 20, 1 << 20).is_err());
}

#[test]
fn weights_of_the_crate_are_sound() {
    for weights in [Weights::builtin(), Weights::builtin_small()] {
        assert!(weights.prior().unwrap().is_some());
        assert_eq!(weights.fit().unwrap().unwrap().method, FitMethod::Joint);
        Completer::new(&weights).unwrap();
    }
    assert!(Weights::builtin_small().parameters() < Weights::builtin().parameters());
}

#[test]
fn depth_between_points_is_plausible() {
    // Every other point of the plane with a step is fitted, and the others are checked.
    let all = observations(160, 120, 800);
    let given: Observations = all.iter().step_by(2).copied().collect();
    let depth = scene_of(&COMPLETER, 160, 120)
        .complete(&given)
        .unwrap()
        .depth()
        .unwrap();
    let left_out: Vec<_> = all.iter().skip(1).step_by(2).collect();
    let off = left_out
        .iter()
        .map(|p| (read(&depth, p.u, p.v) - f64::from(p.depth)).abs());
    let mean = off.sum::<f64>() / left_out.len() as f64;
    assert!(mean < 0.03, "{mean}");
}

#[test]
fn cameras_that_mirror_or_have_no_focal_length_are_refused() {
    let camera = Camera::pinhole([100.0; 2], [31.5, 23.5]);
    let mut mirror = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]];
    let seen = |camera: &Camera, width| Cloud::seen_by(camera, width, 48, [[0.0, 0.0, 2.0]]);
    assert_eq!(seen(&camera, 64).unwrap().observations.len(), 1);
    assert!(seen(&camera, usize::MAX).is_err());
    assert!(seen(&camera.clone().with_pose(mirror, [0.0; 3]), 64).is_err());
    mirror[2][2] = 2.0;
    assert!(seen(&camera.with_pose(mirror, [0.0; 3]), 64).is_err());
    let flat = Camera::pinhole([0.0, 100.0], [31.5, 23.5]);
    assert!(seen(&flat, 64).is_err());
    assert_eq!(flat.unproject([0.0, 0.0], 1.0), None);
}

#[test]
fn lenses_that_are_no_numbers_are_refused() {
    let camera = Camera::pinhole([100.0; 2], [31.5, 23.5]);
    let lens = Lens::fisheye([0.1, f64::NAN, 0.0, 0.0]);
    assert!(camera.check().is_ok());
    assert!(camera.with_lens(lens).check().is_err());
}

#[test]
fn handles_are_printed_without_their_numbers() {
    let completion = scene_of(&COMPLETER, 64, 48)
        .complete(&observations(64, 48, 20))
        .unwrap();
    for text in [
        format!("{completion:?}"),
        format!("{:?}", completion.scene()),
        format!("{:?}", *COMPLETER),
        format!("{:?}", Weights::builtin_small()),
    ] {
        assert!(text.len() < 2000, "{text}");
    }
}

/// Data freed after the only fit to an image is recomputed when needed.
#[test]
fn the_only_fit_to_an_image_is_that_of_any_other() {
    let (width, height) = (320, 240);
    let scene = scene_of(&COMPLETER, width, height);
    let points = observations(width, height, 60_000);
    let kept = scene.complete(&points).unwrap();
    let once = scene.complete_once(&points).unwrap();
    let again = scene.complete(&points).unwrap();
    for other in [once, again] {
        assert_eq!(other.depth().unwrap(), kept.depth().unwrap());
        assert_eq!(other.weights(), kept.weights());
        assert_eq!(
            other.standard_deviation().unwrap(),
            kept.standard_deviation().unwrap()
        );
    }
}

/// A network on a device that fails when a map is computed.
#[derive(Debug)]
struct Failing(Arc<dyn Network>);

#[derive(Debug)]
struct FailingForward(Box<dyn Forward>);

#[derive(Debug)]
struct FailingBasis(Box<dyn Basis>);

impl Network for Failing {
    fn forward(&self, image: &[f32], size: (usize, usize)) -> Result<Box<dyn Forward>> {
        Ok(Box::new(FailingForward(self.0.forward(image, size)?)))
    }
}

impl Forward for FailingForward {
    fn basis(&self) -> Box<dyn Basis> {
        Box::new(FailingBasis(self.0.basis()))
    }

    fn affinities(&self) -> (Vec<f32>, (usize, usize)) {
        self.0.affinities()
    }
}

impl Basis for FailingBasis {
    fn at(&self, size: (usize, usize), places: &[[f64; 2]]) -> Vec<f32> {
        self.0.at(size, places)
    }

    fn combine(&self, (height, width): (usize, usize), _: &[f64]) -> Vec<f32> {
        vec![f32::NAN; height * width]
    }
}

#[test]
fn a_device_that_fails_during_a_completion_is_an_error() {
    let weights = Weights::builtin_small();
    let network = CpuNetwork::new(&weights.network, &weights.tensors, None, Level::here()).unwrap();
    let builder = Completer::builder(&weights).network(Arc::new(Failing(Arc::new(network))));
    let completer = builder.build().unwrap();
    let grey = vec![128_u8; 3 * 64 * 48];
    let image = Image::new(64, 48, Channels::Rgb, &grey).unwrap();
    let mut points = Observations::new();
    for i in 0..30 {
        points.add(f64::from(2 * i), f64::from(i), 2.0);
    }
    let scene = completer.scene(&image).unwrap();
    let depth = scene.complete(&points).and_then(|found| found.depth());
    let error = depth.unwrap_err();
    assert!(error.to_string().contains("not finite"), "{error}");
}
