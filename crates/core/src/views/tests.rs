use super::*;
use crate::{Channels, Completer, Image, Weights};

const WIDTH: usize = 96;
const HEIGHT: usize = 72;
const IDENTITY: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// A camera at a position in the world, rotated to the right by an angle.
fn camera([x, y, z]: [f64; 3], angle: f64) -> Camera {
    let (sin, cos) = angle.sin_cos();
    let rotation = [[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]];
    let translation = rotation.map(|row| -(row[0] * x + row[1] * y + row[2] * z));
    Camera::pinhole([80.0, 80.0], [47.5, 35.5]).with_pose(rotation, translation)
}

/// Returns the depth at a pixel of a camera's view of a wavy wall, z = `distance` + `height` sin(6 x + 5 y).
fn depth(camera: &Camera, pixel: [f64; 2], [distance, height]: [f64; 2]) -> f64 {
    let [from, to] = [0.0, 1.0].map(|depth| camera.unproject(pixel, depth).unwrap());
    let along = [0, 1, 2].map(|i| to[i] - from[i]);
    let mut found = distance;
    // A contraction, because waves are less steep than rays.
    for _ in 0..100 {
        let [x, y] = [0, 1].map(|i| from[i] + found * along[i]);
        let wave = height * (6.0 * x + 5.0 * y).sin();
        found = (distance + wave - from[2]) / along[2];
    }
    found
}

/// Returns points of a wall at every `step`th pixel from the first.
fn wall(camera: &Camera, [first, step]: [usize; 2], shape: [f64; 2]) -> Observations {
    let pixels = (first..WIDTH * HEIGHT).step_by(step);
    let places = pixels.map(|i| [(i % WIDTH) as f64, (i / WIDTH) as f64]);
    let mut points = Observations::new();
    places.for_each(|[u, v]| points.add(u, v, depth(camera, [u, v], shape) as f32));
    points
}

/// Returns the points of a view with depths scaled by a factor.
fn times(view: &PosedView, factor: f64) -> Observations {
    let points = view.observations().iter();
    let times = points.map(|point| Observation {
        depth: point.depth * factor as f32,
        ..*point
    });
    times.collect()
}

fn posed(camera: &Camera, points: Observations) -> PosedView {
    PosedView::new(camera.clone(), WIDTH, HEIGHT, points).unwrap()
}

fn scene_of(threads: usize) -> Scene {
    let completer = Completer::builder(&Weights::builtin_small())
        .threads(threads)
        .build()
        .unwrap();
    let pixels: Vec<u8> = (0..3 * WIDTH * HEIGHT)
        .map(|i| (i / 3 % WIDTH + i / 900) as u8)
        .collect();
    let image = Image::new(WIDTH, HEIGHT, Channels::Rgb, &pixels).unwrap();
    completer.scene(&image).unwrap()
}

fn scene() -> Scene {
    scene_of(1)
}

const SHAPE: [f64; 2] = [3.0, 0.1];

/// Returns a camera with a few points, and other cameras near it.
fn sequence(shape: [f64; 2]) -> (PosedView, Vec<PosedView>) {
    let cameras = [
        camera([0.0, 0.0, 0.0], 0.0),
        camera([0.2, 0.0, 0.1], 0.1),
        camera([-0.3, 0.1, -0.1], -0.1),
    ];
    let own = posed(&cameras[0], wall(&cameras[0], [0, 101], shape));
    let others = cameras[1..].iter().enumerate();
    let others = others.map(|(i, camera)| posed(camera, wall(camera, [i + 7, 31], shape)));
    (own, others.collect())
}

fn refs(views: &[PosedView]) -> Vec<&PosedView> {
    views.iter().collect()
}

#[test]
fn carried_points_lie_on_the_plane_that_both_cameras_see() {
    let (own, others) = sequence(SHAPE);
    let mut report = ViewsReport::new(&refs(&others));
    let carried = carry::carry(&own, &refs(&others), &mut report.views);
    assert!(carried.len() > 80, "{}", carried.len());
    let camera = camera([0.0; 3], 0.0);
    for point in &carried {
        let found = point.observation;
        let expected = depth(&camera, [found.u, found.v], SHAPE);
        assert!(
            (f64::from(found.depth) / expected - 1.0).abs() < 1e-6,
            "{found:?}"
        );
    }
    let outside: usize = report.views.iter().map(|view| view.outside).sum();
    let given: usize = others.iter().map(|view| view.observations().len()).sum();
    assert_eq!(carried.len() + outside, given);
}

#[test]
fn points_of_right_poses_join_the_fit() {
    let (own, others) = sequence(SHAPE);
    let settings = ViewSettings::default();
    let (found, report) = scene()
        .complete_with_views(&own, &refs(&others), &settings)
        .unwrap();
    assert_eq!(report.outcome, ViewsOutcome::Used, "{report:?}");
    assert_eq!(report.count(ViewOutcome::Used), 2);
    assert!(report.carried() > 80, "{report:?}");
    assert_eq!(
        found.report().given,
        own.observations().len() + report.carried()
    );
    for view in &report.views {
        let parts = [
            view.outside,
            view.doubled,
            view.occluded,
            view.contradicting,
            view.thinned,
        ];
        assert_eq!(
            parts.iter().sum::<usize>() + view.carried,
            view.points,
            "{view:?}"
        );
        assert!(view.pose_deviation < 0.02, "{view:?}");
    }
}

#[test]
fn points_behind_a_nearer_surface_are_occluded() {
    let (own, _) = sequence([2.0, 0.0]);
    // Another camera sees a wall two metres behind.
    let aside = camera([0.1, 0.0, 0.0], 0.0);
    let mixed = wall(&aside, [3, 61], [2.0, 0.0])
        .iter()
        .chain(&wall(&aside, [5, 211], [4.0, 0.0]))
        .copied()
        .collect();
    let behind = wall(&aside, [5, 211], [4.0, 0.0]).len();
    let other = posed(&aside, mixed);
    let settings = ViewSettings::default();
    let (_, report) = scene()
        .complete_with_views(&own, &[&other], &settings)
        .unwrap();
    let view = &report.views[0];
    assert_eq!(view.outcome, ViewOutcome::Used, "{report:?}");
    // Points that are inside the image.
    assert!(
        view.occluded > behind * 8 / 10 && view.occluded <= behind,
        "{report:?}"
    );
}

#[test]
fn a_view_with_a_wrong_pose_is_left_out() {
    let (own, mut others) = sequence(SHAPE);
    // Its points belong to a camera a metre nearer to the wall.
    let near = camera([0.0, 0.0, 1.0], 0.0);
    others.push(posed(&camera([0.0; 3], 0.0), wall(&near, [4, 89], SHAPE)));
    let settings = ViewSettings::default();
    let (found, report) = scene()
        .complete_with_views(&own, &refs(&others), &settings)
        .unwrap();
    assert_eq!(
        report.views[2].outcome,
        ViewOutcome::Inconsistent,
        "{report:?}"
    );
    assert_eq!(report.views[2].carried, 0);
    let (without, _) = scene()
        .complete_with_views(&own, &refs(&others[..2]), &settings)
        .unwrap();
    assert_eq!(found.depth().unwrap(), without.depth().unwrap());
    // Without other views, it changes nothing at all.
    let (alone, report) = scene()
        .complete_with_views(&own, &[&others[2]], &settings)
        .unwrap();
    assert_eq!(report.outcome, ViewsOutcome::NoPoints);
    let expected = scene().complete(own.observations()).unwrap();
    assert_eq!(alone.depth().unwrap(), expected.depth().unwrap());
}

#[test]
fn a_point_is_counted_once() {
    let (own, others) = sequence(SHAPE);
    let count = own.observations().len() as u64;
    let own = own.with_ids((0..count).collect()).unwrap();
    // The first view measures twenty points of the image; the second ten of the first view.
    let ids = |view: &PosedView, first: u64| {
        (first..first + view.observations().len() as u64).collect::<Vec<_>>()
    };
    let first = others[0]
        .clone()
        .with_ids(ids(&others[0], count - 20))
        .unwrap();
    let both: Vec<u64> = ids(&others[1], 100_000);
    let second = others[1].clone().with_ids(both.clone()).unwrap();
    let third = others[1].clone().with_ids(both).unwrap();
    let settings = ViewSettings::default();
    let (_, report) = scene()
        .complete_with_views(&own, &[&first, &second, &third], &settings)
        .unwrap();
    assert!(
        report.views[0].doubled > 0 && report.views[0].doubled <= 20,
        "{report:?}"
    );
    assert_eq!(report.views[1].doubled, 0);
    assert_eq!(report.views[2].carried, 0, "{report:?}");
    assert!(others[0].clone().with_ids(vec![1]).is_err());
}

#[test]
fn few_of_many_points_are_spread_over_the_image() {
    let own_camera = camera([0.0; 3], 0.0);
    let own = posed(&own_camera, wall(&own_camera, [0, 701], [3.0, 0.0]));
    let other = posed(&own_camera, wall(&own_camera, [1, 5], [3.0, 0.0]));
    let mut report = ViewsReport::new(&[&other]);
    let mut carried = carry::carry(&own, &[&other], &mut report.views);
    let all = carried.len();
    thin::thin(&own, 100, &mut carried, &mut report.views);
    assert_eq!((carried.len(), report.views[0].thinned), (100, all - 100));
    // Each quarter has its share.
    for right in [false, true] {
        for down in [false, true] {
            let within = carried.iter().filter(|point| {
                (point.observation.u > 47.5) == right && (point.observation.v > 35.5) == down
            });
            assert!((15..=35).contains(&within.count()));
        }
    }
}

#[test]
fn scaling_everything_scales_the_result() {
    let (own, others) = sequence(SHAPE);
    let settings = ViewSettings::default();
    let run = |factor: f64| {
        let scaled = |view: &PosedView, place: [f64; 3], angle: f64| {
            let camera = camera(place.map(|v| v * factor), angle);
            posed(&camera, times(view, factor))
        };
        let own = scaled(&own, [0.0; 3], 0.0);
        let first = scaled(&others[0], [0.2, 0.0, 0.1], 0.1);
        let second = scaled(&others[1], [-0.3, 0.1, -0.1], -0.1);
        let (found, report) = scene()
            .complete_with_views(&own, &[&first, &second], &settings)
            .unwrap();
        assert!(report.carried() > 0);
        (
            found.depth().unwrap(),
            found.standard_deviation().unwrap(),
            report,
        )
    };
    let (depth, deviation, report) = run(1.0);
    for factor in [0.25, 8.0, 1000.0, 0.37] {
        let (scaled, scaled_deviation, scaled_report) = run(factor);
        let exact = factor.log2().fract() == 0.0;
        for (one, other, most) in [
            (&depth, &scaled, 1e-5),
            (&deviation, &scaled_deviation, 1e-4),
        ] {
            let most = if exact { 0.0 } else { most };
            for (one, other) in one.values().iter().zip(other.values()) {
                let off = f64::from(*other) / (f64::from(*one) * factor) - 1.0;
                assert!(off.abs() <= most, "{factor}: {one} {other}");
            }
        }
        assert_eq!(report.carried(), scaled_report.carried());
        let pairs = report.errors.into_iter().zip(scaled_report.errors);
        for (one, other) in pairs.flat_map(|(one, other)| one.into_iter().zip(other)) {
            assert!((other / one - 1.0).abs() < 1e-4, "{factor}: {one} {other}");
        }
        if exact {
            assert_eq!(report.views, scaled_report.views);
        }
    }
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let (own, others) = sequence(SHAPE);
    let settings = ViewSettings::default();
    let run = |threads: usize| {
        let (found, report) = scene_of(threads)
            .complete_with_views(&own, &refs(&others), &settings)
            .unwrap();
        (
            found.depth().unwrap(),
            found.standard_deviation().unwrap(),
            report,
        )
    };
    assert_eq!(run(1), run(2));
}

#[test]
fn without_others_it_is_the_fit_to_the_own_points() {
    let (own, _) = sequence(SHAPE);
    let (found, report) = scene()
        .complete_with_views(&own, &[], &ViewSettings::default())
        .unwrap();
    let expected = scene().complete(own.observations()).unwrap();
    assert_eq!(found.depth().unwrap(), expected.depth().unwrap());
    assert_eq!(
        (report.outcome, report.carried()),
        (ViewsOutcome::NoPoints, 0)
    );
    let other_size = PosedView::new(camera([0.0; 3], 0.0), 10, 10, Observations::new()).unwrap();
    let refused = scene().complete_with_views(&other_size, &[], &ViewSettings::default());
    assert!(refused.unwrap_err().to_string().contains("10x10"));
    let mirror = Camera::pinhole([80.0; 2], [0.0; 2])
        .with_pose([[-1.0, 0.0, 0.0], IDENTITY[1], IDENTITY[2]], [0.0; 3]);
    assert!(PosedView::new(mirror, WIDTH, HEIGHT, Observations::new()).is_err());
}

#[test]
fn neighbours_see_the_same_and_are_bounded() {
    let places: [([f64; 3], f64); 6] = [
        ([0.0, 0.0, 0.0], 0.0),
        ([0.1, 0.0, 0.0], 0.0),
        // The wall behind the camera.
        ([0.0, 0.0, 0.0], std::f64::consts::PI),
        ([0.3, 0.0, 0.0], 0.0),
        ([0.6, 0.0, 0.0], 0.0),
        // Beyond the border of the first camera's view.
        ([9.0, 0.0, 0.0], 0.0),
    ];
    let views: Vec<PosedView> = places
        .iter()
        .map(|&(place, angle)| {
            let camera = camera(place, angle);
            // At angle pi the wall is at z = -3.
            let distance = if angle > 0.0 { -3.0 } else { 3.0 };
            posed(&camera, wall(&camera, [0, 37], [distance, 0.0]))
        })
        .collect();
    let all = ViewSettings::default();
    assert_eq!(neighbours(&views, 0, &all), [1, 3, 4]);
    let two = ViewSettings { count: 2, ..all };
    assert_eq!(neighbours(&views, 0, &two), [1, 3]);
    let past = ViewSettings {
        only_past: true,
        ..all
    };
    assert_eq!(neighbours(&views, 3, &past), [1, 0]);
    assert!(neighbours(&views, 0, &past).is_empty());
    assert!(neighbours(&views, 5, &all).is_empty());
}

/// Reference: scores and sorts all views.
fn plain_neighbours(views: &[PosedView], index: usize, settings: &ViewSettings) -> Vec<usize> {
    let share = |own: &PosedView, other: &PosedView| {
        let points = other.observations().as_slice();
        let tried = points.iter().step_by(points.len().div_ceil(64).max(1));
        let count = tried.len().max(1);
        let seen = tried.filter(|point| carry::seen(own, other, point).is_some());
        seen.count() as f64 / count as f64
    };
    let own = &views[index];
    let score = |other: usize| {
        let view = &views[other];
        let axes = own.axis.unwrap().into_iter().zip(view.axis.unwrap());
        let cosine = axes.map(|(a, b)| a * b).sum::<f64>();
        let shares = [share(own, view), share(view, own)];
        let least = shares[0].min(shares[1]);
        (if least < 0.05 { 0.0 } else { cosine * least }, other)
    };
    let end = if settings.only_past {
        index
    } else {
        views.len()
    };
    let others = (0..end).filter(|&other| other != index);
    let mut found: Vec<(f64, usize)> = others.map(score).collect();
    found.retain(|(score, _)| *score >= 0.05);
    let away = |other: usize| (other.abs_diff(index), other);
    found.sort_by(|a, b| b.0.total_cmp(&a.0).then(away(a.1).cmp(&away(b.1))));
    found.truncate(settings.count);
    found.into_iter().map(|(_, other)| other).collect()
}

#[test]
fn neighbours_are_those_of_a_search_through_all() {
    let mut rng = lsdc_rng::Rng::stream(9, &["neighbours"]);
    let mut views = Vec::new();
    for _ in 0..40 {
        let place = [
            rng.range(-2.0, 2.0),
            rng.range(-1.0, 1.0),
            rng.range(-1.0, 1.0),
        ];
        let camera = camera(place.map(f64::from), f64::from(rng.range(-0.9, 0.9)));
        let view = posed(&camera, wall(&camera, [0, 89], [6.0, 0.0]));
        // Some views several times, so that their scores are equal.
        for _ in 0..=usize::from(rng.chance(0.4)) {
            views.push(view.clone());
        }
    }
    views.push(posed(&camera([0.0; 3], 0.0), Observations::new()));
    let mut found = 0;
    for count in [1, 3, 8, 100] {
        for only_past in [false, true] {
            let settings = ViewSettings {
                count,
                only_past,
                ..ViewSettings::default()
            };
            for index in 0..views.len() {
                let expected = plain_neighbours(&views, index, &settings);
                assert_eq!(neighbours(&views, index, &settings), expected);
                found += expected.len();
            }
        }
    }
    assert!(found > 1000, "{found}");
}

#[test]
fn carried_points_that_enlarge_large_errors_do_not_join() {
    let judgement = |standard_errors, are_large_ones_larger| Judgement {
        errors: Some([0.02, 0.01]),
        standard_errors,
        are_large_ones_larger,
    };
    assert!(judgement(3.0, false).is_better());
    assert!(!judgement(3.0, true).is_better());
    assert!(!judgement(1.9, false).is_better());
}
