//! Calibration of trained basis functions: the prior over their weights, and the scale of prediction errors.

use super::error_calibration::{ErrorCalibration, error_calibration};
use super::truth::random_task;
use super::{Scenes, TrainConfig};
use crate::predict;
use burn::tensor::Device;
use image::RgbImage;
use image::imageops::flip_horizontal;
use lsdc_core::fit::{
    FitConfig, FitMethod, ImageMoments, LAMBDA_COUNTS, Lambda, NoisePrior, Prior, PriorKind,
};
use lsdc_core::{Completer, Observations, Point, Weights};
use lsdc_eval::data::{Dataset, DepthMap, Frame};
use lsdc_eval::metrics::{Metric, Rules, Scores};
use lsdc_eval::predict::scene;
use lsdc_eval::sampling::{Pattern, Protocol};
use lsdc_files::error::{Error, Result};
use lsdc_rng::{self as rng, Rng};
use lsdc_weights::guided_by_head;
use rayon::prelude::*;

/// Limit of training images for learning a prior; each is used with its mirror image.
const IMAGES: usize = 1000;
/// Limit of points per image.
const POINTS: usize = 1000;
/// Weight of the prior size of the covariance, in points: low, because images differ.
const TRUST: f64 = 5.0;
/// Probability of normal errors within one standard deviation.
const ONE_DEVIATION: f64 = 0.6827;

/// Candidates of lambda for basis functions with a field, relative to the variance learned from training images: the fewer the
/// points, the smaller the best one.
const SHARES: [f64; 8] = [0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0];
/// Numbers of points at which lambda is chosen, with numbers of draws: more draws for few points, to average out noise.
const NUMBERS: [(usize, u64); LAMBDA_COUNTS] = [(5, 8), (50, 2), (500, 1)];

/// Smallest number of depths of a frame, so that half of them are enough points.
const FEWEST: usize = 2 * NUMBERS[0].0;

/// Learns the prior over weights from the frames that `config` trained on (at most 1,000) and their mirror images. Learns the
/// strength of the noise and the scale of standard deviations from the held-out frames (all frames if none are held out; at
/// most 1,000), with 500 points each. Stores them in `weights`. With a field, the strength of the noise is replaced by the
/// lambdas that predict held-out frames best, for few and for many points, and the distribution of errors is learned from these
/// frames and returned. Calls `progress` with the number of frames processed and in total.
///
/// If [`keeps_prior`], mean and covariance are unchanged. [Sparse](Frame::is_sparse) depths are divided: at most half of those
/// of a frame are given, and errors are measured at the others.
///
/// # Errors
/// Frames that cannot be read, or fewer than two.
pub fn calibrate(
    weights: &mut Weights,
    frames: &dyn Dataset,
    config: &TrainConfig,
    device: &Device,
    progress: impl Fn(usize, usize) + Sync,
) -> Result<Option<ErrorCalibration>> {
    let (mut training, mut held_out) = config.divide(frames)?;
    if held_out.is_empty() {
        held_out.clone_from(&training);
        if held_out.len() > IMAGES {
            held_out.sort_by_key(|&i| rng::hash(&["held out", &frames.id(i)]));
        }
    }
    if held_out.len() > IMAGES {
        let count = held_out.len();
        tracing::info!("errors are measured on {IMAGES} of {count} held-out frames");
        held_out.truncate(IMAGES);
    }
    training.sort_by_key(|&i| rng::hash(&["prior", &frames.id(i)]));
    if training.len() > IMAGES {
        let count = training.len();
        tracing::info!("the prior is learned from {IMAGES} of {count} training frames");
        training.truncate(IMAGES);
    }
    let kept = if keeps_prior(weights, frames)? {
        training.clear();
        weights.prior()?.map(|(prior, _)| prior)
    } else {
        None
    };
    let completer = predict::completer(weights, device)?;
    let fit = FitConfig {
        prior: PriorKind::Learned,
        ..*completer.fit_config()
    };
    let plain = FitConfig {
        prior: PriorKind::Learned,
        robust: None,
        ..FitConfig::default()
    };
    let completer = completer.with_fit(plain);
    let total = training.len() + held_out.len();
    let load = |index: usize| frame(frames, index, &config.protocol);

    let mut images = Vec::with_capacity(2 * training.len());
    let mut done = 0;
    for some in training.chunks(rayon::current_num_threads()) {
        let found: Vec<[ImageMoments; 2]> = some
            .par_iter()
            .map(|&index| moments(&completer, &load(index)?, config.seed))
            .collect::<Result<_>>()?;
        images.extend(found.into_iter().flatten());
        done += some.len();
        progress(done, total);
    }
    let prior = kept.map_or_else(|| Prior::learn(&images), Ok)?;
    let unknown = NoisePrior {
        mean: prior.noise().mean,
        deviation: None,
        equivalent_points: TRUST,
    };

    // With 500 points, no prior of the noise is needed.
    let completer = completer.with_prior(prior.clone().with_noise(unknown));
    let (fit, measured) = if fit.method == FitMethod::Joint {
        let scale = prior.noise().mean.exp();
        let errors = |lambda: f64| {
            let lambda = Lambda::Fixed(lambda);
            let completer = completer.with_fit(FitConfig { lambda, ..fit });
            errors(&completer, &held_out, &load, config.seed)
        };
        let lambda = best_lambda(SHARES.map(|share| share * scale), errors)?;
        let fit = FitConfig { lambda, ..fit };
        let robust = None;
        (fit, FitConfig { robust, ..fit })
    } else {
        (fit, plain)
    };
    let plain = completer.with_fit(plain);
    let completer = completer.with_fit(measured);
    let mut lambdas = Vec::new();
    let mut ratios = Ratios::new(config.seed);
    for &index in &held_out {
        let frame = load(index)?;
        let task = random_task(&frame, 500, config.seed)?;
        let points = Observations::from_map(&task.sparse);
        let completion = scene(&completer, &frame.rgb)?.complete(&points)?;
        let few = scene(&plain, &frame.rgb)?.complete(&points)?;
        lambdas.extend(few.report().lambda.map(f64::ln));
        let depth = completion.depth()?;
        let deviations = completion.standard_deviation()?;
        let pixels = depth.values().iter().zip(deviations.values());
        for ((depth, deviation), truth) in pixels.zip(task.truth.values()) {
            if *truth > 0.0 && *deviation > 0.0 {
                ratios.add((depth - truth).abs() / deviation);
            }
        }
        done += 1;
        progress(done, total);
    }
    let noise = NoisePrior {
        deviation: Some(deviation(&lambdas).max(0.3)),
        mean: mean(&lambdas),
        equivalent_points: TRUST,
    };
    if ratios.count > RATIOS as u64 {
        let count = ratios.count;
        tracing::info!("standard deviations are scaled by {RATIOS} of {count} pixels");
    }
    weights.record_prior(
        &prior.with_noise(noise),
        ratios.quantile(ONE_DEVIATION),
        None,
    );
    weights.record_fit(&fit);
    if fit.method == FitMethod::Joint {
        let scenes = Scenes::of(frames, config.scenes.as_deref())?;
        let ignore = |_: usize, _: usize| {};
        let learned = learn_errors(weights, frames, &held_out, &scenes, config, device, ignore)?;
        return Ok(Some(learned));
    }
    Ok(None)
}

/// Returns whether [`calibrate`] keeps the prior of weights: fewer frames than basis functions do not determine the covariance
/// of their weights.
///
/// # Errors
/// A damaged prior.
pub fn keeps_prior(weights: &Weights, frames: &dyn Dataset) -> Result<bool> {
    Ok(frames.len() < weights.network.bases && weights.prior()?.is_some())
}

/// Returns the lambda with the smallest errors, for each number of points.
fn best_lambda(
    lambdas: impl IntoIterator<Item = f64>,
    errors: impl Fn(f64) -> Result<[f64; LAMBDA_COUNTS]>,
) -> Result<Lambda> {
    let mut best = [(f64::INFINITY, 0.0); LAMBDA_COUNTS];
    for lambda in lambdas {
        for (best, error) in best.iter_mut().zip(errors(lambda)?) {
            if error < best.0 {
                *best = (error, lambda);
            }
        }
    }
    let chosen = std::array::from_fn(|i| (NUMBERS[i].0 as f64, best[i].1));
    Ok(Lambda::ByCount(chosen))
}

/// Returns the moments of a frame and of its mirror image, for learning the prior.
fn moments(completer: &Completer, frame: &Frame, seed: u64) -> Result<[ImageMoments; 2]> {
    let sparse = Pattern::Exactly(POINTS).draw(frame, seed)?;
    let (width, height) = (sparse.width(), sparse.height());
    let opposite = |point: Point| Point {
        x: width - 1 - point.x,
        ..point
    };
    let opposites: Vec<Point> = sparse.points().map(opposite).collect();
    let of = |rgb: &RgbImage, sparse: &DepthMap| -> Result<ImageMoments> {
        Ok(scene(completer, rgb)?.moments(&Observations::from_map(sparse))?)
    };
    Ok([
        of(&frame.rgb, &sparse)?,
        of(
            &flip_horizontal(&frame.rgb),
            &DepthMap::from_points(width, height, &opposites),
        )?,
    ])
}

/// Learns the error distribution of the joint fit from the frames at `which`, which should not have been used for the network
/// or its prior, and stores it in `weights`; everything else is unchanged. The depth head of the network's encoder guides the
/// fits if it is installed, as outside of training.
///
/// # Errors
/// The weights have no prior, are for another fit, or frames cannot be read.
pub fn learn_errors(
    weights: &mut Weights,
    frames: &dyn Dataset,
    which: &[usize],
    scenes: &Scenes,
    config: &TrainConfig,
    device: &Device,
    progress: impl Fn(usize, usize) + Sync,
) -> Result<ErrorCalibration> {
    let completer = predict::completer(weights, device)?;
    let fit = FitConfig {
        robust: None,
        ..*completer.fit_config()
    };
    let Some((prior, calibration)) = weights.prior()?.filter(|_| fit.method == FitMethod::Joint)
    else {
        return Err(Error::weights(
            "the distribution of errors is that of a joint fit with a prior",
        )
        .hint("calibrate all, with `--fit joint`"));
    };
    let completer = guided_by_head(completer.with_fit(fit))?;
    let found = error_calibration(&completer, frames, which, scenes, config, progress)?;
    weights.record_prior(&prior, calibration.deviation, Some(found.model));
    Ok(found)
}

/// Returns the mean logarithm of errors over frames and draws, for each number of points: of the root mean square and of the
/// relative error, which emphasise far and near depths.
fn errors(
    completer: &Completer,
    frames: &[usize],
    load: &(impl Fn(usize) -> Result<Frame> + Sync),
    seed: u64,
) -> Result<[f64; LAMBDA_COUNTS]> {
    let errors: Vec<[f64; LAMBDA_COUNTS]> = frames
        .par_iter()
        .map(|&index| {
            let frame = load(index)?;
            let scene = scene(completer, &frame.rgb)?;
            let mut means = [0.0; LAMBDA_COUNTS];
            for (mean, (points, draws)) in means.iter_mut().zip(NUMBERS) {
                for draw in 0..draws {
                    let task = random_task(&frame, points, seed + draw)?;
                    let given = Observations::from_map(&task.sparse);
                    let found = scene.complete(&given)?.depth()?;
                    let scores = Scores::of(&found, &task.truth, &Rules::default())?;
                    for metric in [Metric::Rmse, Metric::Rel] {
                        *mean += scores[metric].max(f64::MIN_POSITIVE).ln() / draws as f64;
                    }
                }
            }
            Ok(means)
        })
        .collect::<Result<_>>()?;
    let mut sums = [0.0; LAMBDA_COUNTS];
    for image in &errors {
        for (sum, error) in sums.iter_mut().zip(image) {
            *sum += error;
        }
    }
    Ok(sums)
}

fn frame(frames: &dyn Dataset, index: usize, protocol: &Protocol) -> Result<Frame> {
    let frame = protocol.apply(&frames.load(index)?)?;
    if frame.depth.count() < FEWEST {
        let what = format!("frame `{}` has fewer than {FEWEST} depths", frame.id);
        return Err(Error::shape(what).hint("calibrate without this frame"));
    }
    Ok(frame)
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

fn deviation(values: &[f64]) -> f64 {
    let mean = mean(values);
    let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    (squares / values.len().saturating_sub(1).max(1) as f64).sqrt()
}

/// Ratios of errors to their standard deviations: all of them, or a uniform sample if there are more than [`RATIOS`] (algorithm
/// R of Vitter 1985).
struct Ratios {
    values: Vec<f32>,
    count: u64,
    rng: Rng,
}

/// Sample size: 16 MB, which determines a quantile to 0.05 %.
const RATIOS: usize = 1 << 22;

impl Ratios {
    fn new(seed: u64) -> Self {
        Self {
            values: Vec::new(),
            count: 0,
            rng: Rng::stream(seed, &["ratios"]),
        }
    }

    fn add(&mut self, ratio: f32) {
        self.count += 1;
        if self.values.len() < RATIOS {
            self.values.push(ratio);
            return;
        }
        let share = f64::from(self.rng.below(u32::MAX)) / f64::from(u32::MAX);
        if let Some(value) = self.values.get_mut((share * self.count as f64) as usize) {
            *value = ratio;
        }
    }

    fn quantile(mut self, share: f64) -> f64 {
        let at = (self.values.len() as f64 * share) as usize;
        if at >= self.values.len() {
            return 1.0;
        }
        let (_, found, _) = self.values.select_nth_unstable_by(at, f32::total_cmp);
        f64::from(*found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mirrored_frame_has_the_moments_of_the_frame() {
        let rgb = RgbImage::from_fn(32, 24, |x, y| {
            image::Rgb([(7 * x) as u8, (9 * y) as u8, (x * y) as u8])
        });
        let depth = |x: usize, y: usize| 1.0 + 0.1 * x as f32 + 0.03 * (y * y) as f32;
        let values = |place: &dyn Fn(usize) -> usize| -> Vec<f32> {
            (0..32 * 24).map(|i| depth(place(i % 32), i / 32)).collect()
        };
        let frame = |rgb, values| {
            Frame::new("f".into(), rgb, DepthMap::new(32, 24, values).unwrap()).unwrap()
        };
        let plain = frame(rgb.clone(), values(&|x| x));
        let mirrored = frame(flip_horizontal(&rgb), values(&|x| 31 - x));
        let weights = Weights::builtin_small();
        let completer = predict::completer(&weights, &Device::flex()).unwrap();
        // All pixels are points: each pair contains the same two images, in reverse order.
        let learned = |frame| {
            let [own, opposite] = moments(&completer, frame, 0).unwrap();
            (own, opposite)
        };
        let (own, opposite) = learned(&plain);
        let (their_own, their_opposite) = learned(&mirrored);
        let expected = Prior::learn(&[own, opposite]).unwrap().numbers();
        let found = Prior::learn(&[their_opposite, their_own])
            .unwrap()
            .numbers();
        let scale = expected.0.iter().fold(0.0, |m: f32, v| m.max(v.abs()));
        for (a, b) in expected.0.iter().zip(&found.0) {
            assert!((a - b).abs() < 1e-4 * scale, "{a} {b}");
        }
    }

    #[test]
    fn ratios_take_bounded_memory_and_keep_their_quantile() {
        // Rayleigh distribution: 68.27 % are below sqrt(-2 ln 0.3173). The second half is three times as wide.
        let within = |x: f64| 1.0 - 0.5 * ((-x * x / 2.0).exp() + (-x * x / 18.0).exp());
        let mut ratios = Ratios::new(3);
        let mut rng = Rng::stream(7, &["test"]);
        let count = 2 * RATIOS;
        for i in 0..count {
            let wide = if i < count / 2 { 1.0 } else { 3.0 };
            ratios.add(wide * rng.normal().hypot(rng.normal()));
        }
        assert_eq!((ratios.values.len(), ratios.count), (RATIOS, count as u64));
        let share = within(ratios.quantile(ONE_DEVIATION));
        assert!((share - ONE_DEVIATION).abs() < 0.002, "{share}");
        // A small sample is complete.
        let mut ratios = Ratios::new(0);
        for ratio in [3.0, 1.0, 2.0, 4.0] {
            ratios.add(ratio);
        }
        assert_eq!(ratios.quantile(0.5), 3.0);
        assert_eq!(Ratios::new(0).quantile(0.5), 1.0);
    }
}
