//! Points that are right among points that are wrong: a mixture of two kinds of errors of prediction.
//!
//! Each point is predicted from the others, with a standard deviation that depends on how far away they are and
//! which edges lie between. A right point is off by a multiple of it from a distribution with heavy tails, because
//! a depth edge that the image does not show makes a right point look wrong. The error of a wrong point has nothing
//! to do with it. The scale of the former, the size and the sign of the latter and the share of wrong points are
//! estimated together with the probability that each point is right (expectation maximisation); a point then
//! predicts the others by as much as it is right. At first every point counts as right, so that the scale includes
//! wrong points and only the farthest are dismissed; as they go, predictions improve and the scale shrinks.
//!
//! Once most wrong points are known, the neighbours of a point are asked two things. Where right points are off by
//! more than elsewhere, so may this one be. And a point that agrees with several neighbours, right or not, may lie
//! with them on an object that the image does not show: independent errors do not agree.

use crate::error::Result;
use crate::fit::medians::{deviation, median, weighted_median};
use crate::nearest::Cells;
use rayon::prelude::*;

/// Points to be judged.
#[derive(Clone, Debug)]
pub(super) struct Evidence {
    pub(super) values: Vec<f64>,
    /// The variance of the noise of each value, in the unit of the predictions.
    pub(super) noise: Vec<f64>,
    pub(super) places: Option<Vec<[f64; 2]>>,
    /// What a relative error is relative to.
    pub(super) unit: f64,
    /// Whether the errors of right points grow with their values.
    pub(super) proportional: bool,
}

/// How each point is predicted from the others.
pub(super) trait Predict {
    /// The predictions by points with such variances of their noise.
    fn predict(&self, noise: &[f64]) -> Result<Predictions>;
}

/// Predictions of every point by the others.
#[derive(Clone, Debug)]
pub(super) struct Predictions {
    /// Value minus prediction.
    pub(super) errors: Vec<f64>,
    /// The variance of each prediction, in the unit of the noise.
    pub(super) variances: Vec<f64>,
}

/// What the other points say of a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InlierPosterior {
    /// The probability that the point is right.
    pub right: f64,
    /// Its value minus the one that the others predict.
    pub error: f64,
    /// The scale of the errors that right points have there.
    pub scale: f64,
    /// The inverse variance of noise with which the point has the influence on a fit that it has by that
    /// probability.
    pub(super) precision: f64,
}

/// The most rounds of predictions before neighbours are asked, and with them.
const ROUNDS: [usize; 2] = [8, 4];
/// The same by rough predictions: with 8 and 2, errors of maps are the same; with 1 and 1, those with many wrong points
/// are 2 to 4 % larger.
const ROUGHLY: [usize; 2] = [2, 1];
/// Rounds end when no more points than one in so many change their probability by this.
const SETTLED: (usize, f64) = (1000, 0.02);
/// Steps of expectation maximisation in the first round, and in others.
const STEPS: [usize; 2] = [12, 5];
/// With fewer points there is nothing to compare.
const FEWEST: usize = 4;
/// The least probability that a point is right.
const LEAST: f64 = 1e-6;

/// Judges each of some points by the others, which at first predict with noise of the variances `start`.
pub(super) fn judge<'a>(
    points: &'a Evidence,
    start: &[f64],
    predict: &impl Predict,
) -> Result<Judged<'a>> {
    judge_with(points, Neighbours::new(points), start, predict)
}

/// The same with known neighbours.
pub(super) fn judge_with<'a>(
    points: &'a Evidence,
    neighbours: Neighbours,
    start: &[f64],
    predict: &impl Predict,
) -> Result<Judged<'a>> {
    let mut judged = Judged::new(points, neighbours, start, predict)?;
    if points.values.len() >= FEWEST {
        judged.rounds(false, ROUNDS[0], predict)?;
        judged.rounds(true, ROUNDS[1], predict)?;
        judged.end(doubt(&judged.right));
    }
    Ok(judged)
}

/// The same by rough predictions that cost little, and then by others. Where few points seem wrong by either, there is
/// doubt.
pub(super) fn judge_twice<'a>(
    points: &'a Evidence,
    neighbours: Neighbours,
    start: &[f64],
    rough: &impl Predict,
    predict: &impl Predict,
) -> Result<Judged<'a>> {
    let mut judged = Judged::new(points, neighbours, start, rough)?;
    judged.rounds(false, ROUGHLY[0], rough)?;
    judged.rounds(true, ROUGHLY[1], rough)?;
    let before = doubt(&judged.right);
    let most = rounds_after_rough(&judged.right);
    judged.turn_to(predict)?;
    judged.rounds(true, most, predict)?;
    judged.end(doubt(&judged.right).min(before));
    Ok(judged)
}

/// The most rounds after rough predictions. The more points there are, the more a round costs, and the fewer are needed;
/// but where many are wrong, these spoil the rough predictions, and with few rounds errors of maps are a sixth larger.
pub(super) fn rounds_after_rough(right: &[f64]) -> usize {
    const MANY: f64 = 0.15;
    let [few, many] = match right.len() {
        0..=20_000 => [4, 8],
        20_001..=40_000 => [2, 8],
        _ => [1, 4],
    };
    if share_of_wrong(right) > MANY {
        many
    } else {
        few
    }
}

/// Points, and what is known of them after some rounds.
#[derive(Debug)]
pub(super) struct Judged<'a> {
    points: &'a Evidence,
    neighbours: Neighbours,
    mixture: Mixture,
    /// The last predictions.
    found: Predictions,
    right: Vec<f64>,
    scales: Vec<f64>,
    /// The variances with which the points predict.
    noise: Vec<f64>,
    is_first: bool,
    /// What the odds that a point is wrong are multiplied by in the end.
    doubt: f64,
}

impl<'a> Judged<'a> {
    fn new(
        points: &'a Evidence,
        neighbours: Neighbours,
        start: &[f64],
        predict: &impl Predict,
    ) -> Result<Self> {
        let found = predict.predict(start)?;
        let scales = points.spreads(&found);
        Ok(Self {
            points,
            neighbours,
            mixture: Mixture::new(points, &found.errors, &scales),
            found,
            right: vec![1.0; points.values.len()],
            scales,
            noise: start.to_vec(),
            is_first: true,
            doubt: 1.0,
        })
    }

    /// At most so many rounds, which ask neighbours or not.
    fn rounds(&mut self, asked: bool, most: usize, predict: &impl Predict) -> Result<()> {
        for _ in 0..most {
            if !self.is_first {
                self.found = predict.predict(&self.noise)?;
            }
            let before = self.right.clone();
            self.round(asked);
            if is_settled(&before, &self.right) {
                break;
            }
        }
        Ok(())
    }

    /// Goes on with other predictions, whose errors have the scale that those of right points have.
    fn turn_to(&mut self, predict: &impl Predict) -> Result<()> {
        self.found = predict.predict(&self.noise)?;
        let spreads = self.points.spreads(&self.found);
        let pairs = self.found.errors.iter().zip(&spreads).zip(&self.right);
        let seen = pairs.filter(|(_, right)| **right > 0.5);
        self.mixture
            .scale_by(self.points, &spreads, seen.map(|((e, s), _)| e / s));
        self.is_first = true;
        Ok(())
    }

    /// Ends with this much doubt.
    fn end(&mut self, doubt: f64) {
        self.doubt = doubt;
        doubted(&mut self.right, doubt);
        self.noise = self.points.noise_of(&self.found, &self.right);
    }

    /// Steps of expectation maximisation with the same predictions.
    fn round(&mut self, asked: bool) {
        let (points, errors, mixture) = (self.points, &self.found.errors, &mut self.mixture);
        let spreads = points.spreads(&self.found);
        let neighbours = &self.neighbours;
        let agreement =
            asked.then(|| neighbours.agreement(&points.values, &self.right, mixture.size));
        for _ in 0..STEPS[usize::from(!self.is_first)] {
            self.scales.clone_from(&spreads);
            if asked {
                neighbours.roughen(&mut self.scales, errors, &self.right, mixture.scale);
            }
            for scale in &mut self.scales {
                *scale *= mixture.scale;
            }
            mixture.step(errors, &self.scales, agreement.as_deref(), &mut self.right);
        }
        self.noise = points.noise_of(&self.found, &self.right);
        self.is_first = false;
    }

    /// The variances with which the points predict others.
    pub(super) fn noise(&self) -> &[f64] {
        &self.noise
    }

    /// What the others say of each point.
    pub(super) fn judgements(&self) -> Vec<InlierPosterior> {
        judgements(&self.found, &self.right, &self.scales, &self.noise)
    }

    /// What these points say of others, which they predict with these errors and variances.
    pub(super) fn others(&self, others: &Evidence, found: &Predictions) -> Vec<InlierPosterior> {
        let places = [&others.places, &self.points.places];
        let [places, own] = places.map(|places| places.as_deref().unwrap_or_default());
        let (cells, closest) = (Cells::new(own), self.neighbours.closest);
        let (values, right) = (&self.points.values, &self.right);
        let Mixture { scale, size, .. } = self.mixture;
        let spreads = self.points.spreads(&self.found);
        let squares = squares(&self.found.errors, &spreads, scale);
        let steepest = self.neighbours.steepest(values, right);
        // All points of a cell ask the same neighbours.
        let cell = |(i, &place): (usize, &[f64; 2])| (cells.index(place), i);
        let mut turns: Vec<(usize, usize)> = places.par_iter().enumerate().map(cell).collect();
        turns.par_sort_unstable();
        let groups: Vec<_> = turns.chunk_by(|one, other| one.0 == other.0).collect();
        let asked = groups.par_iter().map(|group| {
            let mut near = cells.nearest(cells.centre(group[0].0), COUNT);
            let rough = roughness(&near, &squares, right);
            let agreeing = group.iter().map(|&(_, i)| {
                for (distance, j) in &mut near {
                    let [u, v] = [0, 1].map(|axis| places[i][axis] - own[*j][axis]);
                    *distance = (u * u + v * v).sqrt().max(closest);
                }
                let slope =
                    |(distance, j): (f64, usize)| (others.values[i] - values[j]).abs() / distance;
                agreement(&near, slope, steepest, size)
            });
            (rough, agreeing.collect())
        });
        let asked: Vec<(f64, Vec<f64>)> = asked.collect();
        let mut scales = others.spreads(found);
        let mut agreement = vec![0.0; scales.len()];
        for (group, (rough, agreeing)) in groups.into_iter().zip(asked) {
            for (&(_, i), agreeing) in group.iter().zip(agreeing) {
                scales[i] *= scale * rough;
                agreement[i] = agreeing;
            }
        }
        let mut right = vec![1.0; scales.len()];
        let parts = right.par_chunks_mut(TOGETHER).enumerate();
        parts.for_each(|(part, right)| {
            let range = part * TOGETHER..part * TOGETHER + right.len();
            let (errors, scales) = (&found.errors[range.clone()], &scales[range.clone()]);
            self.mixture
                .weigh(errors, scales, Some(&agreement[range]), right);
        });
        doubted(&mut right, self.doubt);
        let noise = others.noise_of(found, &right);
        judgements(found, &right, &scales, &noise)
    }
}

fn judgements(
    found: &Predictions,
    right: &[f64],
    scales: &[f64],
    noise: &[f64],
) -> Vec<InlierPosterior> {
    let all = (0..right.len()).map(|i| InlierPosterior {
        right: right[i],
        error: found.errors[i],
        scale: scales[i],
        precision: noise[i].recip(),
    });
    all.collect()
}

/// Whether another round would hardly change the probabilities.
fn is_settled(before: &[f64], after: &[f64]) -> bool {
    let pairs = before.iter().zip(after);
    let changed = pairs.filter(|(b, a)| (*b - *a).abs() > SETTLED.1);
    changed.count() * SETTLED.0 <= before.len()
}

impl InlierPosterior {
    /// Of points with noise of such variances, of which none says anything of another.
    pub(super) fn unknown(noise: &[f64]) -> Vec<Self> {
        let all = noise.iter().map(|noise| Self {
            right: 1.0,
            error: 0.0,
            scale: noise.sqrt(),
            precision: noise.recip(),
        });
        all.collect()
    }
}

impl Evidence {
    /// The standard deviations of predictions and noise, up to a common factor.
    fn spreads(&self, found: &Predictions) -> Vec<f64> {
        /// In units, for predictions that make no sense.
        const LOWEST: f64 = 0.1;
        let relative = |i: usize| {
            if self.proportional {
                ((self.values[i] - found.errors[i]) / self.unit).max(LOWEST)
            } else {
                1.0
            }
        };
        let spread = |i: usize| (found.variances[i] + self.noise[i]).sqrt() * relative(i);
        (0..self.values.len()).into_par_iter().map(spread).collect()
    }

    /// The variances of noise with which points have the influence on a fit that they have by the probabilities
    /// that they are right.
    fn noise_of(&self, found: &Predictions, right: &[f64]) -> Vec<f64> {
        let known = self.noise.par_iter().zip(&found.variances);
        let pairs = known.zip(right);
        let noise = pairs
            .map(|((own, variance), right)| (own + variance * (1.0 - right)) / right.max(LEAST));
        noise.collect()
    }
}

/// Of perfect points, up to 1 % look wrong, because they lie on things that the image does not show. Where so few
/// do, the odds that one is wrong are lower than those that are the same everywhere.
fn doubt(right: &[f64]) -> f64 {
    /// With this share of wrong points and more, there is no doubt.
    const MANY: f64 = 0.06;
    (share_of_wrong(right) / MANY).min(1.0).powi(2)
}

fn share_of_wrong(right: &[f64]) -> f64 {
    let wrong: f64 = right.iter().map(|right| 1.0 - right).sum();
    wrong / right.len() as f64
}

fn doubted(right: &mut [f64], doubt: f64) {
    for right in right {
        *right /= *right + (1.0 - *right) * doubt;
    }
}

/// The parameters of the two kinds of errors.
#[derive(Clone, Copy, Debug)]
struct Mixture {
    /// The scale of the errors of right points, in their spreads.
    scale: f64,
    /// The scale of the errors of wrong points.
    size: f64,
    /// How much values differ.
    differ: f64,
    /// The size of values, and of gross errors.
    unit: f64,
    /// The share of wrong points whose error is above 0.
    above: f64,
    /// The share of wrong points.
    share: f64,
    /// Smaller scales and sizes are rounding.
    least: [f64; 2],
}

/// Smaller errors, in units, are rounding.
const ROUNDING: f64 = 1e-9;
/// The share of wrong points before any is seen, and as many points as that counts.
const EXPECTED: (f64, f64) = (0.02, 50.0);
/// As many wrong points are assumed to be off by as much as depths differ.
const ANYWHERE: f64 = 3.0;
/// As many wrong points of either sign are assumed.
const EITHER: f64 = 10.0;
/// The least share of wrong points.
const FEWEST_WRONG: f64 = 1e-3;
/// The share of right points that lie on something else than the points that predict them.
const HIDDEN: f64 = 0.03;
/// The share of wrong points whose errors have distributions of Cauchy: half of them with the size of the others, half with
/// that of depths. Their tails are heavier than those of right points: an error that is large enough is wrong, however
/// small those of other wrong points are.
const GROSS: f64 = 0.1;
/// However many neighbours agree with a point.
const SURE: f64 = 1e3;

impl Mixture {
    fn new(points: &Evidence, errors: &[f64], spreads: &[f64]) -> Self {
        let least = ROUNDING * points.unit;
        let squares: f64 = errors.iter().map(|e| e * e).sum();
        let middle = median(points.values.iter().copied());
        let rests: Vec<f64> = points.values.iter().map(|value| value - middle).collect();
        let mut mixture = Self {
            scale: 0.0,
            size: (squares / errors.len() as f64).sqrt().max(least),
            differ: deviation(&rests),
            unit: points.unit,
            above: 0.5,
            share: 0.1,
            least: [0.0, least],
        };
        mixture.scale_by(
            points,
            spreads,
            errors.iter().zip(spreads).map(|(e, s)| e / s),
        );
        mixture
    }

    /// The scale of the errors of right points from errors in such spreads.
    fn scale_by(&mut self, points: &Evidence, spreads: &[f64], ratios: impl Iterator<Item = f64>) {
        /// The median of the absolute values of the distribution of right points.
        const MIDDLE: f64 = 0.9;
        self.least[0] = ROUNDING * points.unit / median(spreads.iter().copied());
        self.scale = (median(ratios.map(f64::abs)) / MIDDLE).max(self.least[0]);
    }

    /// A step of expectation maximisation: the probabilities that points are right, for errors of which right
    /// points have such `scales`, then the parameters. `agreement` is how much more likely each point is to agree
    /// with its neighbours as it does if it lies with them on something hidden than if it is wrong.
    fn step(
        &mut self,
        errors: &[f64],
        scales: &[f64],
        agreement: Option<&[f64]>,
        right: &mut [f64],
    ) {
        let parts = right
            .par_chunks_mut(TOGETHER)
            .enumerate()
            .map(|(part, right)| {
                let range = part * TOGETHER..part * TOGETHER + right.len();
                let agreement = agreement.map(|odds| &odds[range.clone()]);
                self.weigh(&errors[range.clone()], &scales[range], agreement, right)
            });
        // In the same order for any number of threads.
        let parts: Vec<Sums> = parts.collect();
        let mut sums = Sums::default();
        for part in &parts {
            for kind in 0..2 {
                sums.squares[kind] += part.squares[kind];
                sums.counts[kind] += part.counts[kind];
            }
            sums.usual += part.usual;
            sums.above += part.above;
        }
        let Sums {
            squares,
            counts,
            usual,
            above,
        } = sums;
        let n = errors.len() as f64;
        self.share = ((counts[1] + EXPECTED.0 * EXPECTED.1) / (n + EXPECTED.1)).max(FEWEST_WRONG);
        if counts[0] > 0.0 {
            self.scale = (self.scale * (squares[0] / counts[0]).sqrt()).max(self.least[0]);
        }
        let squares = squares[1] + ANYWHERE * self.differ * self.differ;
        self.size = (squares / (usual + ANYWHERE)).sqrt().max(self.least[1]);
        self.above = (above + EITHER) / (counts[1] + 2.0 * EITHER);
    }

    /// The probabilities that some points are right, and their part in the parameters.
    fn weigh(
        &self,
        errors: &[f64],
        scales: &[f64],
        agreement: Option<&[f64]>,
        right: &mut [f64],
    ) -> Sums {
        let mut sums = Sums::default();
        for (i, (&error, &scale)) in errors.iter().zip(scales).enumerate() {
            let z = error / scale;
            // Student's t, of 2 degrees of freedom until neighbours are asked, then of 3.
            let (density, pull) = if agreement.is_none() {
                let spread = 1.0 + z * z / 2.0;
                ((8.0 * spread.powi(3)).sqrt().recip(), 1.5 / spread)
            } else {
                let spread = 1.0 + z * z / 3.0;
                let norm = 2.0 / (3.0_f64.sqrt() * std::f64::consts::PI);
                (norm / (spread * spread), 4.0 / (3.0 * spread))
            };
            let side = if error > 0.0 {
                2.0 * self.above
            } else {
                2.0 * (1.0 - self.above)
            };
            // Densities of the error in units of the scale.
            let widths = [self.size, self.unit].map(|size| (1.0 + (size / scale).powi(2)).sqrt());
            let squares = widths.map(|width| (z / width).powi(2));
            let usual = (1.0 - GROSS) * (-0.5 * squares[0]).exp() / (ROOT_TAU * widths[0]);
            let tail =
                |k: usize| 0.5 * GROSS / (std::f64::consts::PI * widths[k] * (1.0 + squares[k]));
            let (heavy, gross) = (tail(0), tail(1));
            let wrong = side * (usual + heavy + gross);
            let hidden = agreement.map_or(0.0, |odds| HIDDEN * odds[i].min(SURE) * wrong);
            let seen = if agreement.is_none() {
                density
            } else {
                (1.0 - HIDDEN) * density
            };
            let (one, other) = ((1.0 - self.share) * (seen + hidden), self.share * wrong);
            right[i] = one / (one + other);
            let seen = right[i] * seen / (seen + hidden);
            sums.squares[0] += seen * pull * z * z;
            sums.counts[0] += seen;
            let of_size = (1.0 - right[i]) / (usual + heavy + gross);
            let pull = usual + heavy * 2.0 / (1.0 + squares[0]);
            sums.squares[1] += of_size * pull * error * error;
            sums.usual += of_size * (usual + heavy);
            sums.counts[1] += 1.0 - right[i];
            sums.above += if error > 0.0 { 1.0 - right[i] } else { 0.0 };
        }
        sums
    }
}

/// What the parameters follow from.
#[derive(Debug, Default)]
struct Sums {
    /// Squared errors of right and of wrong points, and the numbers of both.
    squares: [f64; 2],
    counts: [f64; 2],
    /// The number of wrong points whose errors are of the usual size.
    usual: f64,
    /// The number of wrong points whose error is above 0.
    above: f64,
}

/// Points that a task weighs.
const TOGETHER: usize = 4096;

/// The square root of 2 pi.
const ROOT_TAU: f64 = 2.506_628_274_631_000_7;

/// Neighbours that are asked.
const COUNT: usize = 8;

/// The nearest points of each point.
#[derive(Debug)]
pub(super) struct Neighbours {
    /// Their distances and indices.
    nearest: Vec<Vec<(f64, usize)>>,
    /// Closer neighbours count as so far away.
    closest: f64,
}

impl Neighbours {
    pub(super) fn new(points: &Evidence) -> Self {
        /// Of the median distance.
        const CLOSEST: f64 = 0.1;
        let Some(places) = &points.places else {
            return Self {
                nearest: vec![Vec::new(); points.values.len()],
                closest: 0.0,
            };
        };
        let cells = Cells::new(places);
        let nearest = |found: &mut Vec<(f64, usize)>, (i, place): (usize, &[f64; 2])| {
            cells.find(*place, COUNT + 1, found);
            let others = found.iter().filter(|(_, j)| *j != i).take(COUNT);
            let mut near = Vec::with_capacity(COUNT);
            near.extend(others.map(|&(square, j)| (square.sqrt(), j)));
            near
        };
        let numbered = places.par_iter().enumerate();
        let mut nearest: Vec<_> = numbered.map_init(Vec::new, nearest).collect();
        let distances = nearest.iter().flatten().map(|(distance, _)| *distance);
        let closest = (CLOSEST * median(distances)).max(f64::MIN_POSITIVE);
        for (distance, _) in nearest.iter_mut().flatten() {
            *distance = distance.max(closest);
        }
        Self { nearest, closest }
    }

    /// Each value minus the median of its neighbours'.
    pub(super) fn off(&self, values: &[f64]) -> Vec<f64> {
        let pairs = self.nearest.par_iter().zip(values);
        pairs
            .map(|(near, value)| value - median(near.iter().map(|&(_, j)| values[j])))
            .collect()
    }

    /// Multiplies spreads by how much farther off the neighbours are than the average of points.
    fn roughen(&self, spreads: &mut [f64], errors: &[f64], right: &[f64], scale: f64) {
        let squares = squares(errors, spreads, scale);
        let pairs = spreads.par_iter_mut().zip(&self.nearest);
        pairs.for_each(|(spread, near)| *spread *= roughness(near, &squares, right));
    }

    /// How much more likely each point is to agree with its neighbours as it does if it lies with them on one
    /// surface than if it is wrong by an error of this size.
    fn agreement(&self, values: &[f64], right: &[f64], size: f64) -> Vec<f64> {
        let steepest = self.steepest(values, right);
        let ratio = |(near, value): (&Vec<(f64, usize)>, &f64)| {
            let slope = |(distance, j): (f64, usize)| (value - values[j]).abs() / distance;
            agreement(near, slope, steepest, size)
        };
        self.nearest.par_iter().zip(values).map(ratio).collect()
    }

    /// The steepest slope between neighbours that agree.
    fn steepest(&self, values: &[f64], right: &[f64]) -> f64 {
        /// Of the median slope.
        const STEEPEST: f64 = 1.5;
        let pairs = self.nearest.iter().enumerate().flat_map(|(i, near)| {
            let pair = move |&(distance, j): &(f64, usize)| {
                let slope = (values[i] - values[j]).abs() / distance;
                (slope, right[i] * right[j])
            };
            near.iter().map(pair)
        });
        STEEPEST * weighted_median(pairs.collect())
    }
}

/// The squared errors in units of their spreads times a scale.
fn squares(errors: &[f64], spreads: &[f64], scale: f64) -> Vec<f64> {
    /// Those beyond this are those of points that only seem to be right.
    const MOST: f64 = 64.0;
    let pairs = errors.par_iter().zip(spreads);
    pairs
        .map(|(e, s)| (e / (s * scale)).powi(2).min(MOST))
        .collect()
}

/// How much farther off some neighbours are than the average of points.
fn roughness(near: &[(f64, usize)], squares: &[f64], right: &[f64]) -> f64 {
    /// The neighbours that an average counts as.
    const TRUST: f64 = 3.0;
    /// Less than a square root, which would be that of the variance of the neighbours: their errors have heavy
    /// tails.
    const POWER: f64 = 0.3;
    let (mut sum, mut count) = (TRUST, TRUST);
    for &(_, j) in near {
        sum += right[j] * squares[j];
        count += right[j];
    }
    (sum / count).powf(POWER)
}

/// How much more likely it is that so many neighbours agree with a point if it lies with them on one surface than if it
/// is wrong by an error of this size. They agree if the slope to them is no steeper than is usual among right
/// neighbours. A point that agrees with none lies alone.
fn agreement(
    near: &[(f64, usize)],
    slope: impl Fn((f64, usize)) -> f64,
    steepest: f64,
    size: f64,
) -> f64 {
    /// The probability that a neighbour lies on the same surface.
    const SAME: f64 = 0.4;
    /// The least probability that a wrong point agrees by chance.
    const CHANCE: f64 = 0.02;
    let agreeing = near.iter().filter(|near| slope(**near) <= steepest);
    let agreeing = agreeing.count();
    if agreeing == 0 {
        return 0.0;
    }
    let reach = near.iter().map(|near| near.0).sum::<f64>() / near.len() as f64;
    let chance = (2.0 * steepest * reach / (12.0_f64.sqrt() * size)).clamp(CHANCE, SAME);
    let others = (1.0 - SAME) / (1.0 - chance);
    (SAME / chance).powi(agreeing as i32) * others.powi((near.len() - agreeing) as i32)
}
