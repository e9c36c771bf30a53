//! Guides: predictions of depth by other means, good and bad.
#![allow(clippy::unwrap_used)]
#![cfg(feature = "weights")]

use lsdc_core::settings::{FitConfig, FitMethod, Loss, PriorKind, Robust};
use lsdc_core::{
    Channels, Completer, DepthGuide, DepthMap, GuideKind, Image, Observations, Scene, Weights,
};

const WIDTH: usize = 96;
const HEIGHT: usize = 72;

/// A floor that rises to a wall, and a box in front of them.
fn truth() -> Vec<f32> {
    let depth = |x: usize, y: usize| {
        if (30..60).contains(&x) && (35..60).contains(&y) {
            1.5
        } else {
            4.0 - 0.04 * (y as f32 - 30.0).max(0.0)
        }
    };
    (0..WIDTH * HEIGHT)
        .map(|i| depth(i % WIDTH, i / WIDTH))
        .collect()
}

/// Scattered over the image.
fn points(count: usize) -> Observations {
    let truth = truth();
    let mut points = Observations::new();
    for i in 0..count {
        let (x, y) = ((37 * i + 11) % WIDTH, (53 * i + 29) % HEIGHT);
        points.add(x as f64, y as f64, truth[y * WIDTH + x]);
    }
    points
}

fn error(map: &DepthMap) -> f64 {
    let pairs = map.values().iter().zip(truth());
    let squares: f64 = pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum();
    (squares / (WIDTH * HEIGHT) as f64).sqrt()
}

/// Returns the error and the trust with a guide, or without one.
fn completed(
    completer: &Completer,
    guide: Option<&DepthGuide>,
    count: usize,
) -> (f64, Option<f64>) {
    let grey = vec![128_u8; 3 * WIDTH * HEIGHT];
    let image = Image::new(WIDTH, HEIGHT, Channels::Rgb, &grey).unwrap();
    let scene = match guide {
        None => completer.scene(&image),
        Some(guide) => completer.guided_scene(&image, guide),
    };
    let completion = scene.unwrap().complete(&points(count)).unwrap();
    (
        error(&completion.depth().unwrap()),
        completion.report().guide_trust,
    )
}

fn of(kind: GuideKind, value: impl Fn(f32) -> f32) -> DepthGuide {
    let values: Vec<f32> = truth().into_iter().map(value).collect();
    DepthGuide::new(kind, WIDTH, HEIGHT, &values).unwrap()
}

#[test]
fn good_guides_of_any_kind_scale_and_shift_are_followed() {
    let completer = Completer::new(&Weights::builtin_small()).unwrap();
    let (without, none) = completed(&completer, None, 40);
    assert!(none.is_none());
    for guide in [
        of(GuideKind::Depth, |d| d),
        of(GuideKind::Depth, |d| 0.01 * d + 3.0),
        of(GuideKind::Disparity, |d| 5.0 / d - 0.4),
        of(GuideKind::Log, |d| 0.3 * d.ln() - 7.0),
    ] {
        let (with, trust) = completed(&completer, Some(&guide), 40);
        assert!(trust.unwrap() > 0.0);
        assert!(with < 0.3 * without, "{with} {without}");
    }
}

#[test]
fn guides_of_other_images_do_no_harm() {
    let completer = Completer::new(&Weights::builtin_small()).unwrap();
    let other = |x: usize, y: usize| 2.0 + (x as f32 / 7.0).sin() * (y as f32 / 11.0).cos();
    let values: Vec<f32> = (0..WIDTH * HEIGHT)
        .map(|i| other(i % WIDTH, i / WIDTH))
        .collect();
    let guide = DepthGuide::new(GuideKind::Depth, WIDTH, HEIGHT, &values).unwrap();
    for count in [1, 5, 40, 300] {
        let (without, _) = completed(&completer, None, count);
        let (with, _) = completed(&completer, Some(&guide), count);
        assert!(with < 1.05 * without, "{count}: {with} {without}");
    }
}

#[test]
fn the_scale_of_a_guide_changes_nothing() {
    let completer = Completer::new(&Weights::builtin_small()).unwrap();
    let (one, _) = completed(&completer, Some(&of(GuideKind::Depth, |d| d)), 12);
    let (other, _) = completed(&completer, Some(&of(GuideKind::Depth, |d| 1024.0 * d)), 12);
    assert!((one - other).abs() < 1e-4 * one, "{one} {other}");
}

#[test]
fn a_guide_alone_needs_no_network() {
    let fit = FitConfig {
        method: FitMethod::Joint,
        prior: PriorKind::Learned,
        ..FitConfig::default()
    };
    let completer = Completer::without_network(fit).unwrap();
    let guide = of(GuideKind::Disparity, |d| 1.0 / d + 0.1);
    let (without, _) = completed(&completer, None, 30);
    let (with, trust) = completed(&completer, Some(&guide), 30);
    assert!(
        trust.unwrap() > 0.0 && with < 0.3 * without,
        "{with} {without}"
    );
}

#[test]
fn gaps_are_filled_and_counted() {
    let mut values = truth();
    for (i, value) in values.iter_mut().enumerate() {
        if i % 7 == 0 || i / WIDTH == 20 {
            *value = f32::NAN;
        }
    }
    let missing = values.iter().filter(|v| v.is_nan()).count();
    let guide = DepthGuide::new(GuideKind::Depth, WIDTH, HEIGHT, &values).unwrap();
    assert_eq!(guide.missing(), missing);
    let completer = Completer::new(&Weights::builtin_small()).unwrap();
    let whole = of(GuideKind::Depth, |d| d);
    let (filled, _) = completed(&completer, Some(&guide), 40);
    assert!(filled < 1.5 * completed(&completer, Some(&whole), 40).0 + 0.05);
}

#[test]
fn guides_that_say_nothing_are_refused() {
    for (values, word) in [
        (vec![f32::NAN; 6], "says nothing"),
        (vec![2.0; 6], "says nothing"),
        (vec![-1.0; 6], "says nothing"),
        (vec![1.0; 5], "does not hold"),
    ] {
        let error = DepthGuide::new(GuideKind::Depth, 3, 2, &values).unwrap_err();
        assert!(error.to_string().contains(word), "{error}");
    }
    assert!(DepthGuide::new(GuideKind::Log, 0, 2, &[]).is_err());
}

#[test]
fn a_field_alone_takes_no_guide() {
    let weights = Weights::builtin_small();
    let recorded = weights.fit().unwrap().unwrap();
    let fit = FitConfig {
        method: FitMethod::Field,
        ..recorded
    };
    let completer = Completer::builder(&weights).fit(fit).build().unwrap();
    let guide = of(GuideKind::Depth, |d| d);
    let (without, _) = completed(&completer, None, 40);
    assert_eq!(completed(&completer, Some(&guide), 40), (without, None));
}

#[test]
fn fits_with_other_settings_share_a_scene() {
    let (completer, points) = (
        Completer::new(&Weights::builtin_small()).unwrap(),
        points(60),
    );
    let guide = of(GuideKind::Disparity, |d| 1.0 / d);
    let grey = vec![128_u8; 3 * WIDTH * HEIGHT];
    let image = Image::new(WIDTH, HEIGHT, Channels::Rgb, &grey).unwrap();
    let depth = |scene: &Scene| scene.complete(&points).unwrap().depth().unwrap();
    for method in [FitMethod::Lse, FitMethod::Joint] {
        let plain = FitConfig {
            method,
            robust: None,
            ..*completer.fit_config()
        };
        let robust = Some(Robust::new(Loss::Auto));
        let scene = completer.with_fit(plain).scene(&image).unwrap();
        let own = completer.with_fit(FitConfig { robust, ..plain });
        let shared = scene.with_robust(robust).unwrap();
        assert_eq!(depth(&shared), depth(&own.scene(&image).unwrap()));
        let guided = own.guided_scene(&image, &guide).unwrap();
        assert_eq!(depth(&shared.with_guide(Some(&guide))), depth(&guided));
        assert_ne!(depth(&guided), depth(&scene));
        let back = guided.with_guide(None).with_robust(None).unwrap();
        assert_eq!(depth(&back), depth(&scene));
    }
    let scene = completer.scene(&image).unwrap();
    let tuning = Some(-1.0);
    let wrong = Robust {
        tuning,
        ..Robust::default()
    };
    assert!(scene.with_robust(Some(wrong)).is_err());
}

/// The reference is a scene made with these settings.
#[test]
fn other_fits_to_an_image_do_not_run_the_network_again() {
    // More pixels than the working size, so that maps are interpolated along the edges of the image.
    let (width, height) = (480, 360);
    let completer = Completer::new(&Weights::builtin_small()).unwrap();
    let rgb: Vec<u8> = (0..3 * width * height)
        .map(|i| (i / 700 % 251) as u8)
        .collect();
    let image = Image::new(width, height, Channels::Rgb, &rgb).unwrap();
    let mut points = Observations::new();
    for i in 0..40 {
        let (u, v) = (37 * i % width, 29 * i % height);
        points.add(u as f64, v as f64, 2.0 + u as f32 / 300.0);
    }
    let depth = |scene: &Scene| scene.complete(&points).unwrap().depth().unwrap();
    let scene = completer.scene(&image).unwrap();
    for method in FitMethod::ALL {
        let fit = FitConfig {
            method,
            ..*completer.fit_config()
        };
        let own = completer.with_fit(fit).scene(&image).unwrap();
        assert_eq!(depth(&scene.with_fit(fit).unwrap()), depth(&own));
    }
    let alone = FitConfig {
        method: FitMethod::Lse,
        ..*completer.fit_config()
    };
    let alone = scene.with_fit(alone).unwrap();
    assert!(alone.with_fit(*completer.fit_config()).is_err());
}

/// A street: sky, and a plane from the horizon to the camera, whose depth is 50 times as large at its far end. The shift of the
/// inverse depths is that of laser scans outdoors.
#[test]
fn the_shift_of_a_guide_with_sky_is_small() {
    const SKY: usize = 20;
    let inverse: Vec<f32> = (0..WIDTH * HEIGHT)
        .map(|pixel| (pixel / WIDTH).saturating_sub(SKY) as f32 / (HEIGHT - SKY) as f32)
        .collect();
    let depth = |pixel: usize| 10.0 / (inverse[pixel] + 0.02);
    let mut points = Observations::new();
    for i in 0..40 {
        let (x, y) = (i * 37 % WIDTH, SKY + 1 + i * 23 % (HEIGHT - SKY - 1));
        points.add(x as f64, y as f64, depth(y * WIDTH + x));
    }
    let completer = Completer::without_network(FitConfig::default()).unwrap();
    let grey = vec![128_u8; 3 * WIDTH * HEIGHT];
    let image = Image::new(WIDTH, HEIGHT, Channels::Rgb, &grey).unwrap();
    let error = |guide: DepthGuide| {
        let scene = completer.guided_scene(&image, &guide).unwrap();
        let map = scene.complete(&points).unwrap().depth().unwrap();
        let ground = WIDTH * (SKY + 1)..WIDTH * HEIGHT;
        let errors = ground
            .clone()
            .map(|i| f64::from(map.values()[i] / depth(i) - 1.0).abs());
        errors.sum::<f64>() / ground.len() as f64
    };
    let known = error(DepthGuide::with_sky(WIDTH, HEIGHT, &inverse).unwrap());
    let disparity = GuideKind::Disparity;
    let unknown = error(DepthGuide::new(disparity, WIDTH, HEIGHT, &inverse).unwrap());
    assert!(known < 0.02 && known < 0.5 * unknown, "{known}, {unknown}");
}

#[test]
fn the_sky_of_a_predicted_guide_is_not_measured() {
    /// Rows of sky at the top.
    const SKY: usize = 20;
    let completer = Completer::new(&Weights::builtin_small()).unwrap();
    let mut inverse: Vec<f32> = truth().into_iter().map(f32::recip).collect();
    inverse[..SKY * WIDTH].fill(0.0);
    let guide = DepthGuide::with_sky(WIDTH, HEIGHT, &inverse).unwrap();
    let grey = vec![128_u8; 3 * WIDTH * HEIGHT];
    let image = Image::new(WIDTH, HEIGHT, Channels::Rgb, &grey).unwrap();
    let scene = completer.guided_scene(&image, &guide).unwrap();
    let ground = points(120);
    let mut ground: Observations = ground
        .iter()
        .filter(|p| p.v >= SKY as f64)
        .copied()
        .collect();
    // In mean distances between points, as in the implementation.
    let near = 2.0 * ((WIDTH * HEIGHT) as f64 / (ground.len() + 1) as f64).sqrt();
    // Whether the standard deviation is at least the depth at each pixel, and the number of sky pixels.
    let unmeasured = |points: &Observations| {
        let completion = scene.complete(points).unwrap();
        let deviation = completion.standard_deviation().unwrap();
        let depth = completion.depth().unwrap();
        let pairs = deviation.values().iter().zip(depth.values());
        let large: Vec<bool> = pairs.map(|(deviation, depth)| deviation >= depth).collect();
        (large, completion.sky_pixels())
    };
    let (large, sky) = unmeasured(&ground);
    assert_eq!(sky, SKY * WIDTH);
    for (pixel, large) in large.into_iter().enumerate() {
        assert_eq!(large, pixel < SKY * WIDTH, "{pixel}");
    }

    // What was measured is not sky.
    ground.add(48.0, 8.0, 4.0);
    let (large, sky) = unmeasured(&ground);
    let mut measured = 0;
    for (pixel, large) in large.into_iter().enumerate().take(SKY * WIDTH) {
        let (x, y) = ((pixel % WIDTH) as f64, (pixel / WIDTH) as f64);
        let is_near = (x - 48.0).hypot(y - 8.0) <= near;
        measured += usize::from(is_near);
        assert_eq!(large, !is_near, "{x}, {y}");
    }
    assert_eq!(sky, SKY * WIDTH - measured);
}

/// The points determine depth as the guide minus 1, which is below 0 at the lower border, in front of all of them.
#[test]
fn in_front_of_all_points_depths_stay_positive_and_are_uncertain() {
    let slope: Vec<f32> = (0..WIDTH * HEIGHT)
        .map(|pixel| 8.0 - 0.1 * (pixel / WIDTH) as f32)
        .collect();
    let guide = DepthGuide::new(GuideKind::Depth, WIDTH, HEIGHT, &slope).unwrap();
    let mut points = Observations::new();
    for i in 0..80 {
        let (x, y) = (i * 37 % WIDTH, i * 23 % 50);
        points.add(x as f64, y as f64, slope[y * WIDTH] - 1.0);
    }
    let nearest = slope[49 * WIDTH] - 1.0;
    let completer = Completer::without_network(FitConfig::default()).unwrap();
    let grey = vec![128_u8; 3 * WIDTH * HEIGHT];
    let image = Image::new(WIDTH, HEIGHT, Channels::Rgb, &grey).unwrap();
    let scene = completer.guided_scene(&image, &guide).unwrap();
    let completion = scene.complete(&points).unwrap();
    let (map, deviations) = (
        completion.depth().unwrap(),
        completion.standard_deviation().unwrap(),
    );
    let near = 0.7 * nearest;
    let pairs = map.values().iter().zip(deviations.values());
    let in_front: Vec<_> = pairs.filter(|(depth, _)| **depth < near).collect();
    assert!(in_front.len() > 5 * WIDTH, "{}", in_front.len());
    assert_eq!(completion.clamped_pixels(&map), in_front.len());
    for (&depth, &deviation) in in_front {
        assert!(depth > 0.11 * nearest, "{depth}");
        assert!(
            deviation >= 0.999 * (near - depth).powi(2) / depth,
            "{depth}, {deviation}"
        );
    }
}
