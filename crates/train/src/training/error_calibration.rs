//! Calibration of the error distribution of completed depth, on frames that the network was not trained on.

use super::truth::{limited, task};
use super::{Scenes, TrainConfig};
use lsdc_core::fit::{CALIBRATION_NODES, CalibrationNode, ErrorModel, ErrorSample, student_t};
use lsdc_core::{Completer, Observation, Observations};
use lsdc_eval::data::{Dataset, DepthMap, Frame, Point};
use lsdc_eval::predict::scene;
use lsdc_eval::sampling::{CompletionTask, Pattern};
use lsdc_files::error::{Error, Result};
use lsdc_rng::{self as rng, Rng};
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Numbers of points at which the distribution is learned.
pub const NUMBERS: [usize; CALIBRATION_NODES] = [5, 50, 500, 5000];
/// The largest number of points.
const MOST: usize = NUMBERS[CALIBRATION_NODES - 1];
/// Limit of frames for the calibration.
const FRAMES: usize = 80;
/// Number of pixels sampled per completion.
const PIXELS: usize = 300;
/// Number of groups of scenes for cross-validation.
const PARTS: u64 = 4;

/// A calibrated error distribution, with its cross-validated coverage.
#[derive(Clone, Debug)]
pub struct ErrorCalibration {
    /// The distribution learned from all frames.
    pub model: ErrorModel,
    /// For each of [`NUMBERS`], the shares of errors within intervals of 68.27 and 95.45 %, with exponents learned from other
    /// [scenes](Scenes::unit); `None` for a single scene.
    pub coverage: Option<[(f64, f64); CALIBRATION_NODES]>,
    /// Number of frames used for the calibration.
    pub frames: usize,
    /// Number of these frames that have so few depths that half of them were given instead of the largest of [`NUMBERS`].
    pub halved: usize,
}

/// Errors of a frame, for each number of points.
type Errors = [Vec<ErrorSample>; CALIBRATION_NODES];

/// Learns the distribution of errors from a subset of the frames at `which`, balanced over scenes as far as possible. Points
/// are arranged in six ways: random, on a grid, on lines, at corners, in one half of the image, and random with noise of known
/// standard deviations. Of sparse depths, at most half are given, whatever the number is.
///
/// # Errors
/// Frames cannot be read, or there are too few.
pub(super) fn error_calibration(
    completer: &Completer,
    frames: &dyn Dataset,
    which: &[usize],
    scenes: &Scenes,
    config: &TrainConfig,
    progress: impl Fn(usize, usize) + Sync,
) -> Result<ErrorCalibration> {
    let mut chosen = scenes.spread(frames, which, "errors");
    chosen.truncate(FRAMES);
    let (done, halved) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let found: Vec<(&str, Errors)> = chosen
        .par_iter()
        .map(|&index| {
            let frame = config.protocol.apply(&frames.load(index)?)?;
            if limited(&frame, MOST) < MOST {
                halved.fetch_add(1, Ordering::Relaxed);
            }
            let errors = errors(completer, &frame, config.seed)?;
            let count = done.fetch_add(1, Ordering::Relaxed);
            progress(count + 1, chosen.len());
            Ok((scenes.name(index), errors))
        })
        .collect::<Result<_>>()?;
    let learned = |wanted: &dyn Fn(&str) -> bool| -> Option<ErrorModel> {
        let mut knots = Vec::new();
        for (i, number) in NUMBERS.into_iter().enumerate() {
            let some = found.iter().filter(|(scene, _)| wanted(scene));
            let samples: Vec<ErrorSample> =
                some.flat_map(|(_, errors)| errors[i].clone()).collect();
            knots.push(CalibrationNode::learn(number as f64, &samples)?);
        }
        knots.try_into().ok().map(ErrorModel)
    };
    let model = learned(&|_| true)
        .ok_or_else(|| Error::config("there are too few depths to learn errors from"))?;
    let part = |scene: &str| rng::hash(&["part", scene]) % PARTS;
    let parts: Vec<u64> = (0..PARTS)
        .filter(|p| found.iter().any(|(scene, _)| part(scene) == *p))
        .collect();
    let mut counts = [(0, 0, 0); CALIBRATION_NODES];
    for &own in parts.iter().filter(|_| parts.len() > 1) {
        let Some(other) = learned(&|scene| part(scene) != own) else {
            continue;
        };
        for (_, errors) in found.iter().filter(|(scene, _)| part(scene) == own) {
            for ((count, samples), knot) in counts.iter_mut().zip(errors).zip(&other.0) {
                let bounds = lsdc_eval::metrics::LEVELS.map(|l| student_t::bound(l, knot.freedom));
                for (features, error) in samples {
                    let ratio = f64::from(error.abs()) / knot.scale(features);
                    count.0 += 1;
                    count.1 += usize::from(ratio < bounds[0]);
                    count.2 += usize::from(ratio < bounds[1]);
                }
            }
        }
    }
    let share =
        |(all, one, two): (usize, usize, usize)| (one as f64 / all as f64, two as f64 / all as f64);
    let measured = counts.iter().all(|count| count.0 > 0);
    Ok(ErrorCalibration {
        model,
        coverage: measured.then(|| counts.map(share)),
        frames: chosen.len(),
        halved: halved.into_inner(),
    })
}

/// Measures the errors at some pixels of a frame, with points in every pattern.
fn errors(completer: &Completer, frame: &Frame, seed: u64) -> Result<Errors> {
    let scene = scene(completer, &frame.rgb)?;
    let mut found = Errors::default();
    for (samples, number) in found.iter_mut().zip(NUMBERS) {
        // A pattern may contain almost none of the sparse depths; such draws do not count as completions of this number of
        // points.
        let fewest = if frame.is_sparse() {
            NUMBERS[0].max(limited(frame, number) / 2)
        } else {
            1
        };
        for (name, CompletionTask { sparse, truth }) in arrangements(frame, number, seed)? {
            if sparse.count() < fewest {
                continue;
            }
            let points = Observations::from_map(&sparse);
            let points = if name == "measured" {
                measured(&points, &frame.id, seed)
            } else {
                points
            };
            let completion = scene.complete(&points)?;
            let (features, (height, width)) = completion.features()?;
            let mean = completion.mean_depth();
            let mut rng = Rng::stream(seed, &["errors", &frame.id, &number.to_string(), name]);
            let (mut known, mut places) = (Vec::new(), Vec::new());
            for (block, point) in pixels(&truth, frame.is_sparse(), (height, width), &mut rng) {
                known.push((features[block], point.depth));
                places.push([point.x as f64, point.y as f64]);
            }
            let depths = completion.at(&places)?;
            let pairs = known.into_iter().zip(depths);
            samples.extend(pairs.map(|((features, truth), depth)| {
                (features, (f64::from(depth - truth) / mean) as f32)
            }));
        }
    }
    Ok(found)
}

/// Returns some pixels with true depths, and their blocks on a grid of these rows and columns: the centres of random blocks, if
/// their depth is known; for sparse depths, any pixels with a depth.
fn pixels(
    truth: &DepthMap,
    is_sparse: bool,
    (height, width): (usize, usize),
    rng: &mut Rng,
) -> Vec<(usize, Point)> {
    let (rows, columns) = (truth.height(), truth.width());
    let across = |at: usize, from: usize, to: usize| {
        let place = (at as f64 + 0.5) * to as f64 / from as f64;
        (place as usize).min(to - 1)
    };
    if is_sparse {
        let mut points: Vec<Point> = truth.points().collect();
        rng.choose(&mut points, PIXELS);
        points.truncate(PIXELS);
        let block = |p: &Point| across(p.y, rows, height) * width + across(p.x, columns, width);
        return points.into_iter().map(|p| (block(&p), p)).collect();
    }
    let blocks = (0..PIXELS).map(|_| rng.below((height * width) as u32) as usize);
    let middles = blocks.map(|block| {
        let x = across(block % width, width, columns);
        let y = across(block / width, height, rows);
        let depth = truth.at(x, y);
        (block, Point { x, y, depth })
    });
    middles.filter(|(_, point)| point.depth > 0.0).collect()
}

/// Returns about `number` points of a frame in different patterns, with the depths to compare with.
fn arrangements(
    frame: &Frame,
    number: usize,
    seed: u64,
) -> Result<Vec<(&'static str, CompletionTask)>> {
    let number = limited(frame, number);
    let (height, width) = (frame.depth.height(), frame.depth.width());
    let candidates = if frame.is_sparse() {
        frame.depth.count()
    } else {
        height * width
    };
    let step = (candidates as f64 / number as f64).sqrt() as usize;
    // A laser scanner with 64 lines has 5,000 points in such an image.
    let lines = ((number as f64).powf(0.45).round() as usize).max(2);
    let lines = Pattern::Lines(lines).draw(frame, seed)?;
    let thinned = |map: DepthMap| {
        let frame = Frame {
            depth: map,
            ..frame.clone()
        };
        Pattern::Exactly(number).draw(&frame, seed)
    };
    let mut grid = Pattern::Grid(step.max(1)).draw(frame, seed)?;
    if frame.is_sparse() {
        grid = thinned(grid)?;
    }
    let found = [
        ("uniform", Pattern::Exactly(number).draw(frame, seed)?),
        ("grid", grid),
        ("lines", thinned(lines)?),
        ("corners", Pattern::Corners(number).draw(frame, seed)?),
        ("half", Pattern::Half(number).draw(frame, seed)?),
        ("measured", Pattern::Exactly(number).draw(frame, seed + 1)?),
    ];
    let tasks = found.into_iter();
    tasks
        .map(|(name, points)| Ok((name, task(frame, points)?)))
        .collect()
}

/// Returns the points with simulated noise of known standard deviations, which differ between points.
fn measured(points: &Observations, id: &str, seed: u64) -> Observations {
    let mut rng = Rng::stream(seed, &["measured", id]);
    let relative = 10.0_f32.powf(rng.range(-2.5, -1.0));
    let noisy = points.iter().map(|point| {
        let sigma = relative * point.depth * rng.range(0.5, 1.5);
        let depth = point.depth + sigma * rng.normal();
        Observation {
            depth: depth.max(0.5 * point.depth),
            sigma: Some(sigma),
            ..*point
        }
    });
    noisy.collect()
}
