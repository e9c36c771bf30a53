//! The quality `best`: the mean of the completions of an image and of its mirror image.

#![cfg(feature = "weights")]
#![allow(clippy::unwrap_used)]

use lsdc_core::settings::{FitConfig, FitMethod, Loss, Robust};
use lsdc_core::{
    Channels, Completer, Completion, DepthGuide, DepthMap, Error, FitError, GuideKind, Image,
    Observation, Observations, Quality, Scene, Weights,
};
use std::sync::LazyLock;

static COMPLETER: LazyLock<Completer> =
    LazyLock::new(|| Completer::new(&Weights::builtin_small()).unwrap());

/// An image without symmetry, and points of a plane with a step.
struct Frame {
    size: (usize, usize),
    rgb: Vec<u8>,
    points: Observations,
}

impl Frame {
    fn new(width: usize, height: usize, count: usize) -> Self {
        let colour = |i: usize| {
            let (x, y) = (i % width, i / width);
            let edge = if x * x / width > y { 200 } else { 40 };
            [x * 250 / width, y * 250 / height, edge].map(|v| v as u8)
        };
        let point = |i: usize| {
            // In quarters of a pixel, so that mirrored positions are exact.
            let (u, v) = (37 * i % (4 * width - 4), 53 * i % (4 * height - 4));
            let (u, v) = (u as f64 / 4.0, v as f64 / 4.0);
            let step = if 3.0 * u > width as f64 { 0.5 } else { 0.0 };
            let depth = 2.0 + 0.8 * u / width as f64 + 0.5 * v / height as f64 + step;
            Observation {
                u,
                v,
                depth: depth as f32,
                sigma: None,
            }
        };
        Self {
            size: (width, height),
            rgb: (0..width * height).flat_map(colour).collect(),
            points: (0..count).map(point).collect(),
        }
    }

    fn mirrored(&self) -> Self {
        let pixels: Vec<&[u8]> = self.rgb.chunks(3).collect();
        Self {
            rgb: mirrored(&pixels, self.size.0).concat(),
            points: self.mirrored_points(&self.points),
            ..*self
        }
    }

    fn mirrored_points(&self, points: &Observations) -> Observations {
        let mirrored = points.iter().map(|point| Observation {
            u: self.size.0 as f64 - 1.0 - point.u,
            ..*point
        });
        mirrored.collect()
    }

    fn scene(&self, completer: &Completer) -> Scene {
        let image = Image::new(self.size.0, self.size.1, Channels::Rgb, &self.rgb).unwrap();
        completer.scene(&image).unwrap()
    }

    fn best(&self, completer: &Completer) -> Scene {
        self.scene(&completer.with_quality(Quality::Best))
    }

    /// Returns the completions of the image and of its mirror image, and their mean.
    fn completed(&self, completer: &Completer) -> [Completion; 3] {
        let mirror = self.mirrored();
        [
            self.scene(completer).complete(&self.points).unwrap(),
            mirror.scene(completer).complete(&mirror.points).unwrap(),
            self.best(completer).complete(&self.points).unwrap(),
        ]
    }
}

fn mirrored<T: Copy>(values: &[T], width: usize) -> Vec<T> {
    let pixel = |i: usize| values[i / width * width + width - 1 - i % width];
    (0..values.len()).map(pixel).collect()
}

/// Returns the mean of a map and that of the mirror image.
fn mean(own: &DepthMap, of_mirror: &DepthMap) -> Vec<f32> {
    let others = mirrored(of_mirror.values(), own.width());
    let pairs = own.values().iter().zip(others);
    pairs.map(|(a, b)| 0.5 * (a + b)).collect()
}

/// Checks that values of observations are means of both fits.
fn assert_means(best: &[f64], own: &[f64], of_mirror: &[f64]) {
    assert!(best.iter().any(|value| value.is_finite()));
    for (i, value) in best.iter().enumerate() {
        let mean = 0.5 * (own[i] + of_mirror[i]);
        assert!(
            *value == mean || value.is_nan() && mean.is_nan(),
            "{i}: {value} {mean}"
        );
    }
}

/// Checks every result of a completion against those of image and mirror image.
fn assert_is_mean(frame: &Frame, [own, of_mirror, best]: &[Completion; 3]) {
    let (width, height) = frame.size;
    let other_size = (width + 7, height - 5);
    for (width, height) in [frame.size, other_size] {
        let map = |one: &Completion| one.depth_at(width, height).unwrap();
        assert_eq!(map(best).values(), mean(&map(own), &map(of_mirror)));
        let mut written = vec![0.0; width * height];
        best.write_depth(width, height, width, &mut written)
            .unwrap();
        assert_eq!(map(best).values(), written);
        let map = |one: &Completion| one.standard_deviation_at(width, height).unwrap();
        assert_eq!(map(best).values(), mean(&map(own), &map(of_mirror)));
    }
    let places = [[0.25, 3.5], [31.75, 20.0], [width as f64 - 1.0, 0.0]];
    let there = places.map(|[u, v]| [width as f64 - 1.0 - u, v]);
    let [own_depths, others] = [own.at(&places).unwrap(), of_mirror.at(&there).unwrap()];
    for (i, depth) in best.at(&places).unwrap().into_iter().enumerate() {
        assert_eq!(depth, 0.5 * (own_depths[i] + others[i]));
    }
    for numbers in [
        Completion::residuals,
        Completion::leave_one_out,
        Completion::point_weights,
    ] {
        assert_means(&numbers(best), &numbers(own), &numbers(of_mirror));
    }
    let root_mean_square = |mut values: Vec<f64>| {
        values.retain(|value| !value.is_nan());
        let squares: f64 = values.iter().map(|value| value * value).sum();
        (squares / values.len() as f64).sqrt()
    };
    let residual = root_mean_square(best.residuals());
    assert!((best.report().residual / residual - 1.0).abs() < 1e-9);
    let left_out = root_mean_square(best.leave_one_out());
    assert!((best.leave_one_out_error().unwrap() / left_out - 1.0).abs() < 1e-9);
    assert_eq!(best.freedom(), own.freedom());
    let limited = |one: &Completion| one.report().limited;
    assert_eq!(limited(best), limited(own).max(limited(of_mirror)));
    // Both contribute.
    let map = |one: &Completion| one.depth().unwrap();
    assert_ne!(map(own).values(), mirrored(map(of_mirror).values(), width));
}

fn with_method(method: FitMethod) -> Completer {
    COMPLETER.with_fit(FitConfig {
        method,
        ..*COMPLETER.fit_config()
    })
}

#[test]
fn a_completion_is_the_mean_of_those_of_an_image_and_of_its_mirror_image() {
    assert_eq!(COMPLETER.quality(), Quality::Standard);
    let frame = Frame::new(96, 72, 80);
    for method in FitMethod::ALL {
        assert_is_mean(&frame, &frame.completed(&with_method(method)));
    }
}

#[test]
fn larger_images_and_measured_points_are_mirrored_too() {
    let mut frame = Frame::new(400, 300, 150);
    assert_is_mean(&frame, &frame.completed(&COMPLETER));
    // Dense enough for smoothing, and for a map that follows each depth.
    let points = (0..400 * 300).filter(|i| i % 7 > 0).map(|i| Observation {
        u: f64::from(i % 400),
        v: f64::from(i / 400),
        depth: 2.0 + 0.001 * (i % 400) as f32 + 0.01 * (i % 5) as f32,
        sigma: Some(0.02),
    });
    frame.points = points.collect();
    let all = frame.completed(&COMPLETER);
    assert!(all[2].report().smoothed > 0);
    assert_is_mean(&frame, &all);
}

#[test]
fn the_mirror_image_has_the_mirrored_maps() {
    let frame = Frame::new(96, 72, 80);
    let mirror = frame.mirrored();
    let completed = |frame: &Frame| frame.best(&COMPLETER).complete(&frame.points).unwrap();
    let [here, there] = [completed(&frame), completed(&mirror)];
    assert_eq!(
        here.depth().unwrap().values(),
        mirrored(there.depth().unwrap().values(), 96)
    );
    assert_eq!(
        here.standard_deviation().unwrap().values(),
        mirrored(there.standard_deviation().unwrap().values(), 96)
    );
    assert_eq!(here.leave_one_out(), there.leave_one_out());
}

#[test]
fn scaling_depths_scales_the_mean() {
    let frame = Frame::new(96, 72, 80);
    let scene = frame.best(&COMPLETER);
    let twice = frame.points.iter().map(|point| Observation {
        depth: 2.0 * point.depth,
        ..*point
    });
    let near = scene.complete(&frame.points).unwrap();
    let far = scene.complete(&twice.collect()).unwrap();
    for map in [Completion::depth, Completion::standard_deviation] {
        let (near, far) = (map(&near).unwrap(), map(&far).unwrap());
        for (near, far) in near.values().iter().zip(far.values()) {
            assert!((far / near - 2.0).abs() < 1e-4, "{near} {far}");
        }
    }
}

#[test]
fn points_on_the_borders_are_used_in_both_images() {
    let mut frame = Frame::new(96, 72, 40);
    // The left border belongs to the image, the right one does not.
    frame.points.add(-0.5, 10.0, 2.0);
    frame.points.add(95.5, 10.0, 2.0);
    let completion = frame.best(&COMPLETER).complete(&frame.points).unwrap();
    assert_eq!(
        (completion.report().used, completion.report().outside),
        (41, 1)
    );
    let residuals = completion.residuals();
    assert!(residuals[40].is_finite() && residuals[41].is_nan());
    assert!(completion.at(&[[-0.5, 10.0]]).unwrap()[0] > 0.0);
}

#[test]
fn an_outlier_is_one_by_the_mean_of_both_probabilities() {
    let mut frame = Frame::new(96, 72, 150);
    let mut points: Vec<Observation> = frame.points.iter().copied().collect();
    points[40].depth += 1.5;
    frame.points = points.into_iter().collect();
    let [own, of_mirror, best] = frame
        .completed(&COMPLETER)
        .map(|one| one.outliers().unwrap()[0]);
    assert_eq!([own.index, of_mirror.index, best.index], [40; 3]);
    let means = [
        (best.probability, own.probability, of_mirror.probability),
        (best.error, own.error, of_mirror.error),
        (best.weight, own.weight, of_mirror.weight),
    ];
    for (best, own, of_mirror) in means {
        assert!((best - 0.5 * (own + of_mirror)).abs() < 1e-9);
    }
    // The scales are those of both fits: score = error / scale.
    let scales = [own, of_mirror].map(|one| one.error / one.score);
    assert!((best.score * 0.5 * (scales[0] + scales[1]) / best.error - 1.0).abs() < 1e-9);
}

#[test]
fn guides_are_mirrored() {
    let frame = Frame::new(96, 72, 60);
    let mirror = frame.mirrored();
    let ramp: Vec<f32> = (0..96 * 72).map(|i| 1.0 + (i % 96) as f32).collect();
    let guide = |values: &[f32]| DepthGuide::new(GuideKind::Depth, 96, 72, values).unwrap();
    let [here, there] = [guide(&ramp), guide(&mirrored(&ramp, 96))];
    let guided = |frame: &Frame, completer: &Completer, guide: &DepthGuide| {
        let image = Image::new(96, 72, Channels::Rgb, &frame.rgb).unwrap();
        let scene = completer.guided_scene(&image, guide).unwrap();
        scene.complete(&frame.points).unwrap().depth().unwrap()
    };
    let best = guided(&frame, &COMPLETER.with_quality(Quality::Best), &here);
    let own = guided(&frame, &COMPLETER, &here);
    let expected = mean(&own, &guided(&mirror, &COMPLETER, &there));
    for (best, expected) in best.values().iter().zip(expected) {
        // Sums over the guide have another order.
        assert!((best / expected - 1.0).abs() < 1e-3, "{best} {expected}");
    }
    // A guide that is added later has the same effect.
    let later = frame.best(&COMPLETER).with_guide(Some(&here));
    let later = later.complete(&frame.points).unwrap().depth().unwrap();
    assert_eq!(later, best);
}

#[test]
fn other_settings_reach_both_images() {
    let frame = Frame::new(96, 72, 80);
    let scene = frame.best(&COMPLETER);
    let robust = FitConfig {
        robust: Some(Robust::new(Loss::Cauchy)),
        ..*COMPLETER.fit_config()
    };
    let plain = FitConfig {
        method: FitMethod::Lse,
        ..robust
    };
    for fit in [robust, plain] {
        let depth = |scene: &Scene| scene.complete(&frame.points).unwrap().depth().unwrap();
        let anew = frame.best(&COMPLETER.with_fit(fit));
        assert_eq!(depth(&scene.with_fit(fit).unwrap()), depth(&anew));
    }
}

#[test]
fn the_next_frame_of_a_video_starts_from_both_fits() {
    let frame = Frame::new(96, 72, 80);
    let all = frame.completed(&COMPLETER);
    let few: Observations = frame.points.iter().take(3).copied().collect();
    let mirrored_few = frame.mirrored_points(&few);
    let near = |one: &Completion, points: &Observations, weights: &Completion| {
        let near = one.scene().complete_near(points, weights.weights());
        near.map(|near| near.depth().unwrap())
    };
    let [own, of_mirror, best] = &all;
    let expected = mean(
        &near(own, &few, own).unwrap(),
        &near(of_mirror, &mirrored_few, of_mirror).unwrap(),
    );
    assert_eq!(near(best, &few, best).unwrap().values(), expected);
    // The weights of one fit do not determine those of the other.
    let (count, weights) = (own.weights().len(), best.weights());
    for found in [0, count, 2 * count - 1] {
        let near = best.scene().complete_near(&few, &weights[..found]);
        let refused = FitError::OtherWeights {
            expected: 2 * count,
            found,
        };
        assert!(
            matches!(&near, Err(Error::Fit(error)) if *error == refused),
            "{near:?}"
        );
    }
}

#[test]
fn a_pixel_counts_as_clamped_if_either_fit_clamps_it() {
    let mut frame = Frame::new(96, 72, 60);
    // Between such points, the paper's fit extrapolates far beyond them.
    let points = frame.points.iter().enumerate();
    let points = points.map(|(i, point)| Observation {
        depth: if i.is_multiple_of(3) { 20.0 } else { 1.0 },
        ..*point
    });
    frame.points = points.collect();
    let all = frame.completed(&COMPLETER.with_fit(FitConfig::default()));
    let is_clamped = |depth: f32| !(0.7..200.0).contains(&depth);
    let clamped = |depths: &[f32]| depths.iter().filter(|&&depth| is_clamped(depth)).count();
    for (width, height) in [frame.size, (50, 40)] {
        let maps = all
            .each_ref()
            .map(|one| one.depth_at(width, height).unwrap());
        let [own, of_mirror, best] = &maps;
        let others = mirrored(of_mirror.values(), width);
        let pairs = own.values().iter().zip(&others);
        let either = pairs
            .filter(|&(&own, &other)| is_clamped(own) || is_clamped(other))
            .count();
        assert_eq!(all[0].clamped_pixels(own), clamped(own.values()));
        assert_eq!(all[2].clamped_pixels(best), either);
        assert!(clamped(best.values()) < either);
    }
}

#[test]
fn points_are_compared_at_other_places_by_single_fits() {
    let frame = Frame::new(96, 72, 300);
    let scenes = [frame.scene(&COMPLETER), frame.best(&COMPLETER)];
    let [standard, best] = scenes
        .each_ref()
        .map(|scene| scene.alignment(&frame.points).unwrap());
    assert!(best.shift().is_some());
    assert_eq!(best, standard);
    let there = [frame.mirrored_points(&frame.points)];
    let [standard, best] = scenes
        .each_ref()
        .map(|scene| scene.compare(&frame.points, &there).unwrap());
    assert!(best.best().is_some());
    assert_eq!(best, standard);
}

#[test]
fn without_a_network_the_mirror_image_has_the_mirrored_depths() {
    let mut frame = Frame::new(96, 72, 60);
    // In general position: a triangulation of points on a grid has ties.
    let points = (1..=60).map(|i| {
        let steps = [(0.754_877_666, 95.0), (0.569_840_291, 71.0)];
        let [u, v] = steps.map(|(step, length): (f64, f64)| {
            (64.0 * (step * f64::from(i)).fract() * length).floor() / 64.0
        });
        let wall = if u > 32.0 { 0.5 } else { 0.0 };
        Observation {
            u,
            v,
            depth: (2.0 + 0.8 * u / 96.0 + 0.5 * v / 72.0 + wall) as f32,
            sigma: None,
        }
    });
    frame.points = points.collect();
    let fit = *with_method(FitMethod::Joint).fit_config();
    let completer = Completer::without_network(fit).unwrap();
    let [own, of_mirror, best] = frame.completed(&completer).map(|one| one.depth().unwrap());
    let (low, high) = own.range().unwrap();
    assert!(high - low > 1.0);
    let others = mirrored(of_mirror.values(), 96);
    for (i, own) in own.values().iter().enumerate() {
        for depth in [others[i], best.values()[i]] {
            assert!((depth / own - 1.0).abs() < 1e-5, "{i}: {depth} {own}");
        }
    }
}
