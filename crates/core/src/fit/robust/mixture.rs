//! Inliers and outliers among points: a mixture of two kinds of prediction errors.
//!
//! Each point is predicted from the others, with a standard deviation that depends on their distances and on the edges
//! between them. The standardised error of an inlier follows a heavy-tailed distribution, because a depth edge that the
//! image does not show makes an inlier look wrong. The error of an outlier does not depend on that standard deviation. The
//! scale of the inliers, the size and the sign of the outliers and their share are estimated together with the probability
//! that each point is an inlier (expectation maximisation); a point then predicts the others with a weight by that
//! probability. At first every point counts as an inlier, so that the scale includes outliers and only the farthest are
//! rejected; without them, predictions improve and the scale shrinks.
//!
//! Once most outliers are known, two tests use the neighbours of a point. Inliers near a point with larger errors increase
//! its tolerance. And a point that agrees with several neighbours, inliers or not, may lie with them on an object that the
//! image does not show: independent errors do not agree.

use crate::error::Result;
use crate::fit::medians::{deviation, median, weighted_median};
use crate::nearest::NeighbourGrid;
use rayon::prelude::*;

/// Points of the outlier test.
#[derive(Clone, Debug)]
pub(super) struct TestedPoints {
    pub(super) values: Vec<f64>,
    /// The variance of the noise of each value, in the unit of the predictions.
    pub(super) noise: Vec<f64>,
    pub(super) places: Option<Vec<[f64; 2]>>,
    /// The unit of relative errors.
    pub(super) unit: f64,
}

/// Predicts each point from the others.
pub(super) trait Predict {
    /// Returns the predictions from points with these noise variances.
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

/// The probability that a point is an inlier, given the other points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InlierPosterior {
    /// The probability that the point is an inlier.
    pub p_inlier: f64,
    /// Its value minus its prediction by the others.
    pub error: f64,
    /// The scale of the errors of inliers there.
    pub scale: f64,
    /// The inverse noise variance that gives the point its influence on a fit at this probability.
    pub(super) precision: f64,
}

/// Largest number of rounds of predictions without and with tests by neighbours.
const ROUNDS: [usize; 2] = [8, 4];
/// The same for rough predictions: with 8 and 2, errors of maps are unchanged; with 1 and 1, they are 2 to 4 % larger if there
/// are many outliers.
const ROUGHLY: [usize; 2] = [2, 1];
/// Rounds end when at most one in this many points changes its probability by more than the given amount.
const SETTLED: (usize, f64) = (1000, 0.02);
/// Number of expectation-maximisation steps in the first round, and in others.
const STEPS: [usize; 2] = [12, 5];
/// Least number of points for a comparison.
const FEWEST: usize = 4;
/// The least probability that a point is an inlier.
const LEAST: f64 = 1e-6;

/// Tests each point by the others. `start` are the noise variances of the first predictions.
pub(super) fn test_outliers<'a>(
    points: &'a TestedPoints,
    start: &[f64],
    predict: &impl Predict,
) -> Result<OutlierTest<'a>> {
    test_outliers_with(points, NearestPoints::new(points), start, predict)
}

/// Like [`test_outliers`], with known neighbours.
pub(super) fn test_outliers_with<'a>(
    points: &'a TestedPoints,
    neighbours: NearestPoints,
    start: &[f64],
    predict: &impl Predict,
) -> Result<OutlierTest<'a>> {
    let mut test = OutlierTest::new(points, neighbours, start, predict)?;
    if points.values.len() >= FEWEST {
        test.rounds(false, ROUNDS[0], predict)?;
        test.rounds(true, ROUNDS[1], predict)?;
        test.finish(odds_factor(&test.p_inlier));
    }
    Ok(test)
}

/// Like [`test_outliers`], first with rough but fast predictions, then with others. The smaller number of outliers of both
/// determines the final odds.
pub(super) fn test_outliers_in_two_stages<'a>(
    points: &'a TestedPoints,
    neighbours: NearestPoints,
    start: &[f64],
    rough: &impl Predict,
    predict: &impl Predict,
) -> Result<OutlierTest<'a>> {
    let mut test = OutlierTest::new(points, neighbours, start, rough)?;
    test.rounds(false, ROUGHLY[0], rough)?;
    test.rounds(true, ROUGHLY[1], rough)?;
    let before = odds_factor(&test.p_inlier);
    let most = rounds_after_rough(&test.p_inlier);
    test.switch_predictions(predict)?;
    test.rounds(true, most, predict)?;
    test.finish(odds_factor(&test.p_inlier).min(before));
    Ok(test)
}

/// Returns the largest number of rounds after rough predictions. With more points, a round takes longer, and fewer are needed;
/// but many outliers disturb the rough predictions, and with few rounds errors of maps are a sixth larger.
pub(super) fn rounds_after_rough(p_inlier: &[f64]) -> usize {
    const MANY: f64 = 0.15;
    let [few, many] = match p_inlier.len() {
        0..=20_000 => [4, 8],
        20_001..=40_000 => [2, 8],
        _ => [1, 4],
    };
    if outlier_share(p_inlier) > MANY {
        many
    } else {
        few
    }
}

/// Points, and their estimates after some rounds.
#[derive(Debug)]
pub(super) struct OutlierTest<'a> {
    points: &'a TestedPoints,
    neighbours: NearestPoints,
    mixture: Mixture,
    /// The last predictions.
    predictions: Predictions,
    p_inlier: Vec<f64>,
    scales: Vec<f64>,
    /// The noise variances of the points in predictions.
    noise: Vec<f64>,
    is_first: bool,
    /// The factor of the final odds that a point is an outlier.
    odds_factor: f64,
}

impl<'a> OutlierTest<'a> {
    fn new(
        points: &'a TestedPoints,
        neighbours: NearestPoints,
        start: &[f64],
        predict: &impl Predict,
    ) -> Result<Self> {
        let predictions = predict.predict(start)?;
        let scales = points.spreads(&predictions);
        Ok(Self {
            points,
            neighbours,
            mixture: Mixture::new(points, &predictions.errors, &scales),
            predictions,
            p_inlier: vec![1.0; points.values.len()],
            scales,
            noise: start.to_vec(),
            is_first: true,
            odds_factor: 1.0,
        })
    }

    /// Runs at most `most` rounds, with or without tests by neighbours.
    fn rounds(&mut self, with_neighbours: bool, most: usize, predict: &impl Predict) -> Result<()> {
        for _ in 0..most {
            if !self.is_first {
                self.predictions = predict.predict(&self.noise)?;
            }
            let before = self.p_inlier.clone();
            self.round(with_neighbours);
            if is_settled(&before, &self.p_inlier) {
                break;
            }
        }
        Ok(())
    }

    /// Switches to other predictions, and sets the scale to that of the errors of inliers.
    fn switch_predictions(&mut self, predict: &impl Predict) -> Result<()> {
        self.predictions = predict.predict(&self.noise)?;
        let spreads = self.points.spreads(&self.predictions);
        let pairs = self
            .predictions
            .errors
            .iter()
            .zip(&spreads)
            .zip(&self.p_inlier);
        let inliers = pairs.filter(|(_, p_inlier)| **p_inlier > 0.5);
        self.mixture
            .scale_by(self.points, &spreads, inliers.map(|((e, s), _)| e / s));
        self.is_first = true;
        Ok(())
    }

    /// Multiplies the odds that points are outliers by a factor.
    fn finish(&mut self, odds_factor: f64) {
        self.odds_factor = odds_factor;
        scale_odds(&mut self.p_inlier, odds_factor);
        self.noise = self.points.noise_of(&self.predictions, &self.p_inlier);
    }

    /// Runs expectation-maximisation steps with the same predictions.
    fn round(&mut self, with_neighbours: bool) {
        let (points, errors, mixture) = (self.points, &self.predictions.errors, &mut self.mixture);
        let spreads = points.spreads(&self.predictions);
        let neighbours = &self.neighbours;
        let agreement = with_neighbours
            .then(|| neighbours.agreement(&points.values, &self.p_inlier, mixture.outlier_scale));
        for _ in 0..STEPS[usize::from(!self.is_first)] {
            self.scales.clone_from(&spreads);
            if with_neighbours {
                neighbours.scale_by_roughness(
                    &mut self.scales,
                    errors,
                    &self.p_inlier,
                    mixture.scale,
                );
            }
            for scale in &mut self.scales {
                *scale *= mixture.scale;
            }
            mixture.step(
                errors,
                &self.scales,
                agreement.as_deref(),
                &mut self.p_inlier,
            );
        }
        self.noise = points.noise_of(&self.predictions, &self.p_inlier);
        self.is_first = false;
    }

    /// Returns the noise variances of the points in predictions.
    pub(super) fn noise(&self) -> &[f64] {
        &self.noise
    }

    /// The posterior of each point.
    pub(super) fn posteriors(&self) -> Vec<InlierPosterior> {
        posteriors(&self.predictions, &self.p_inlier, &self.scales, &self.noise)
    }

    /// Returns the posteriors of other points, predicted from these with the given errors and variances.
    pub(super) fn others(
        &self,
        others: &TestedPoints,
        predictions: &Predictions,
    ) -> Vec<InlierPosterior> {
        let places = [&others.places, &self.points.places];
        let [places, own] = places.map(|places| places.as_deref().unwrap_or_default());
        let (cells, closest) = (NeighbourGrid::new(own), self.neighbours.closest);
        let (values, p_inlier) = (&self.points.values, &self.p_inlier);
        let Mixture {
            scale,
            outlier_scale,
            ..
        } = self.mixture;
        let spreads = self.points.spreads(&self.predictions);
        let squares = squares(&self.predictions.errors, &spreads, scale);
        let steepest = self.neighbours.steepest(values, p_inlier);
        // All points of a cell have the same neighbours.
        let cell = |(i, &place): (usize, &[f64; 2])| (cells.index(place), i);
        let mut turns: Vec<(usize, usize)> = places.par_iter().enumerate().map(cell).collect();
        turns.par_sort_unstable();
        let groups: Vec<_> = turns.chunk_by(|one, other| one.0 == other.0).collect();
        let by_group = groups.par_iter().map(|group| {
            let mut near = cells.nearest(cells.centre(group[0].0), COUNT);
            let rough = roughness(&near, &squares, p_inlier);
            let agreeing = group.iter().map(|&(_, i)| {
                for (distance, j) in &mut near {
                    let [u, v] = [0, 1].map(|axis| places[i][axis] - own[*j][axis]);
                    *distance = (u * u + v * v).sqrt().max(closest);
                }
                let slope =
                    |(distance, j): (f64, usize)| (others.values[i] - values[j]).abs() / distance;
                agreement(&near, slope, steepest, outlier_scale)
            });
            (rough, agreeing.collect())
        });
        let by_group: Vec<(f64, Vec<f64>)> = by_group.collect();
        let mut scales = others.spreads(predictions);
        let mut agreement = vec![0.0; scales.len()];
        for (group, (rough, agreeing)) in groups.into_iter().zip(by_group) {
            for (&(_, i), agreeing) in group.iter().zip(agreeing) {
                scales[i] *= scale * rough;
                agreement[i] = agreeing;
            }
        }
        let mut p_inlier = vec![1.0; scales.len()];
        let parts = p_inlier.par_chunks_mut(TOGETHER).enumerate();
        parts.for_each(|(part, p_inlier)| {
            let range = part * TOGETHER..part * TOGETHER + p_inlier.len();
            let (errors, scales) = (&predictions.errors[range.clone()], &scales[range.clone()]);
            self.mixture
                .weigh(errors, scales, Some(&agreement[range]), p_inlier);
        });
        scale_odds(&mut p_inlier, self.odds_factor);
        let noise = others.noise_of(predictions, &p_inlier);
        posteriors(predictions, &p_inlier, &scales, &noise)
    }
}

fn posteriors(
    predictions: &Predictions,
    p_inlier: &[f64],
    scales: &[f64],
    noise: &[f64],
) -> Vec<InlierPosterior> {
    let all = (0..p_inlier.len()).map(|i| InlierPosterior {
        p_inlier: p_inlier[i],
        error: predictions.errors[i],
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
    /// Returns the posteriors of points with these noise variances that do not predict each other.
    pub(super) fn unknown(noise: &[f64]) -> Vec<Self> {
        let all = noise.iter().map(|noise| Self {
            p_inlier: 1.0,
            error: 0.0,
            scale: noise.sqrt(),
            precision: noise.recip(),
        });
        all.collect()
    }
}

impl TestedPoints {
    /// The standard deviations of predictions and noise, up to a common factor.
    fn spreads(&self, predictions: &Predictions) -> Vec<f64> {
        /// In units, for implausible predictions.
        const LOWEST: f64 = 0.1;
        let relative =
            |i: usize| ((self.values[i] - predictions.errors[i]) / self.unit).max(LOWEST);
        let spread = |i: usize| (predictions.variances[i] + self.noise[i]).sqrt() * relative(i);
        (0..self.values.len()).into_par_iter().map(spread).collect()
    }

    /// Returns the noise variances that give points the influence on a fit of the probabilities that they are inliers.
    fn noise_of(&self, predictions: &Predictions, p_inlier: &[f64]) -> Vec<f64> {
        let known = self.noise.par_iter().zip(&predictions.variances);
        let pairs = known.zip(p_inlier);
        let noise = pairs.map(|((own, variance), p_inlier)| {
            (own + variance * (1.0 - p_inlier)) / p_inlier.max(LEAST)
        });
        noise.collect()
    }
}

/// Returns a factor of the odds that a point is an outlier. Among perfect points, up to 1 % look like outliers, because they
/// are on objects that the image does not show. With so few outliers, the odds are reduced.
fn odds_factor(p_inlier: &[f64]) -> f64 {
    /// Least share of outliers at which the factor is 1.
    const MANY: f64 = 0.06;
    (outlier_share(p_inlier) / MANY).min(1.0).powi(2)
}

fn outlier_share(p_inlier: &[f64]) -> f64 {
    let wrong: f64 = p_inlier.iter().map(|p_inlier| 1.0 - p_inlier).sum();
    wrong / p_inlier.len() as f64
}

fn scale_odds(p_inlier: &mut [f64], odds_factor: f64) {
    for p_inlier in p_inlier {
        *p_inlier /= *p_inlier + (1.0 - *p_inlier) * odds_factor;
    }
}

/// The parameters of the two kinds of errors.
#[derive(Clone, Copy, Debug)]
struct Mixture {
    /// Scale of the errors of inliers, in units of their spreads.
    scale: f64,
    /// The scale of the errors of outliers.
    outlier_scale: f64,
    /// The robust standard deviation of the values.
    value_deviation: f64,
    /// The size of values, and of gross errors.
    unit: f64,
    /// The share of outliers whose error is above 0.
    positive: f64,
    /// The share of outliers.
    share: f64,
    /// Least scales and sizes, limited by rounding.
    least: [f64; 2],
}

/// Least relative error, limited by rounding.
const ROUNDING: f64 = 1e-9;
/// The prior share of outliers, and its weight as a number of points.
const EXPECTED: (f64, f64) = (0.02, 50.0);
/// Number of assumed outliers whose errors are as large as the differences between depths.
const ANYWHERE: f64 = 3.0;
/// Number of assumed outliers of either sign.
const EITHER: f64 = 10.0;
/// The least share of outliers.
const FEWEST_WRONG: f64 = 1e-3;
/// Share of inliers on another object than the points that predict them.
const HIDDEN: f64 = 0.03;
/// The share of outliers whose errors follow Cauchy distributions: half of them with the size of the others, half with that
/// of depths. Their tails are heavier than those of inliers: a point with a large enough error is an outlier, however
/// small the errors of the other outliers are.
const GROSS: f64 = 0.1;
/// The largest odds of agreement, however many neighbours agree with a point.
const SURE: f64 = 1e3;

impl Mixture {
    fn new(points: &TestedPoints, errors: &[f64], spreads: &[f64]) -> Self {
        let least = ROUNDING * points.unit;
        let squares: f64 = errors.iter().map(|e| e * e).sum();
        let middle = median(points.values.iter().copied());
        let centred: Vec<f64> = points.values.iter().map(|value| value - middle).collect();
        let mut mixture = Self {
            scale: 0.0,
            outlier_scale: (squares / errors.len() as f64).sqrt().max(least),
            value_deviation: deviation(&centred),
            unit: points.unit,
            positive: 0.5,
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

    /// Estimates the scale of the errors of inliers from errors with these spreads.
    fn scale_by(
        &mut self,
        points: &TestedPoints,
        spreads: &[f64],
        ratios: impl Iterator<Item = f64>,
    ) {
        /// The median of the absolute values of the distribution of inliers.
        const MIDDLE: f64 = 0.9;
        self.least[0] = ROUNDING * points.unit / median(spreads.iter().copied());
        self.scale = (median(ratios.map(f64::abs)) / MIDDLE).max(self.least[0]);
    }

    /// Runs a step of expectation maximisation: first the probabilities that points are inliers, whose errors have these
    /// `scales`, then the parameters. `agreement` is the likelihood ratio of each point's agreement with its neighbours, for a
    /// point on a hidden object with them over an outlier.
    fn step(
        &mut self,
        errors: &[f64],
        scales: &[f64],
        agreement: Option<&[f64]>,
        p_inlier: &mut [f64],
    ) {
        let parts = p_inlier
            .par_chunks_mut(TOGETHER)
            .enumerate()
            .map(|(part, p_inlier)| {
                let range = part * TOGETHER..part * TOGETHER + p_inlier.len();
                let agreement = agreement.map(|odds| &odds[range.clone()]);
                self.weigh(&errors[range.clone()], &scales[range], agreement, p_inlier)
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
            sums.positive += part.positive;
        }
        let Sums {
            squares,
            counts,
            usual,
            positive,
        } = sums;
        let n = errors.len() as f64;
        self.share = ((counts[1] + EXPECTED.0 * EXPECTED.1) / (n + EXPECTED.1)).max(FEWEST_WRONG);
        if counts[0] > 0.0 {
            self.scale = (self.scale * (squares[0] / counts[0]).sqrt()).max(self.least[0]);
        }
        let squares = squares[1] + ANYWHERE * self.value_deviation * self.value_deviation;
        self.outlier_scale = (squares / (usual + ANYWHERE)).sqrt().max(self.least[1]);
        self.positive = (positive + EITHER) / (counts[1] + 2.0 * EITHER);
    }

    /// Returns the probabilities that some points are inliers, and their contribution to the parameters.
    fn weigh(
        &self,
        errors: &[f64],
        scales: &[f64],
        agreement: Option<&[f64]>,
        p_inlier: &mut [f64],
    ) -> Sums {
        let mut sums = Sums::default();
        for (i, (&error, &scale)) in errors.iter().zip(scales).enumerate() {
            let z = error / scale;
            // Student's t, of 2 degrees of freedom without tests by neighbours, then of 3.
            let (density, pull) = if agreement.is_none() {
                let spread = 1.0 + z * z / 2.0;
                ((8.0 * spread.powi(3)).sqrt().recip(), 1.5 / spread)
            } else {
                let spread = 1.0 + z * z / 3.0;
                let norm = 2.0 / (3.0_f64.sqrt() * std::f64::consts::PI);
                (norm / (spread * spread), 4.0 / (3.0 * spread))
            };
            let side = if error > 0.0 {
                2.0 * self.positive
            } else {
                2.0 * (1.0 - self.positive)
            };
            // Densities of the error in units of the scale.
            let widths = [self.outlier_scale, self.unit]
                .map(|outlier_scale| (1.0 + (outlier_scale / scale).powi(2)).sqrt());
            let squares = widths.map(|width| (z / width).powi(2));
            let usual = (1.0 - GROSS) * (-0.5 * squares[0]).exp() / (ROOT_TAU * widths[0]);
            let tail =
                |k: usize| 0.5 * GROSS / (std::f64::consts::PI * widths[k] * (1.0 + squares[k]));
            let (heavy, gross) = (tail(0), tail(1));
            let wrong = side * (usual + heavy + gross);
            let hidden = agreement.map_or(0.0, |odds| HIDDEN * odds[i].min(SURE) * wrong);
            let visible = if agreement.is_none() {
                density
            } else {
                (1.0 - HIDDEN) * density
            };
            let (one, other) = ((1.0 - self.share) * (visible + hidden), self.share * wrong);
            p_inlier[i] = one / (one + other);
            let visible = p_inlier[i] * visible / (visible + hidden);
            sums.squares[0] += visible * pull * z * z;
            sums.counts[0] += visible;
            let of_size = (1.0 - p_inlier[i]) / (usual + heavy + gross);
            let pull = usual + heavy * 2.0 / (1.0 + squares[0]);
            sums.squares[1] += of_size * pull * error * error;
            sums.usual += of_size * (usual + heavy);
            sums.counts[1] += 1.0 - p_inlier[i];
            sums.positive += if error > 0.0 { 1.0 - p_inlier[i] } else { 0.0 };
        }
        sums
    }
}

/// The sufficient statistics of the parameters.
#[derive(Debug, Default)]
struct Sums {
    /// Squared errors of inliers and of outliers, and the numbers of both.
    squares: [f64; 2],
    counts: [f64; 2],
    /// The number of outliers whose errors are of the usual size.
    usual: f64,
    /// The number of outliers whose error is above 0.
    positive: f64,
}

/// Points per task.
const TOGETHER: usize = 4096;

/// The square root of 2 pi.
const ROOT_TAU: f64 = 2.506_628_274_631_000_7;

/// Number of neighbours of a point.
const COUNT: usize = 8;

/// The nearest points of each point.
#[derive(Debug)]
pub(super) struct NearestPoints {
    /// Their distances and indices.
    nearest: Vec<Vec<(f64, usize)>>,
    /// The least distance of neighbours: closer ones count as this far away.
    closest: f64,
}

impl NearestPoints {
    pub(super) fn new(points: &TestedPoints) -> Self {
        /// Least distance relative to the median distance.
        const CLOSEST: f64 = 0.1;
        let Some(places) = &points.places else {
            return Self {
                nearest: vec![Vec::new(); points.values.len()],
                closest: 0.0,
            };
        };
        let cells = NeighbourGrid::new(places);
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

    /// Returns the difference of each value from the median of its neighbours.
    pub(super) fn differences(&self, values: &[f64]) -> Vec<f64> {
        let pairs = self.nearest.par_iter().zip(values);
        pairs
            .map(|(near, value)| value - median(near.iter().map(|&(_, j)| values[j])))
            .collect()
    }

    /// Multiplies spreads by the size of the errors of the neighbours relative to those of all points.
    fn scale_by_roughness(
        &self,
        spreads: &mut [f64],
        errors: &[f64],
        p_inlier: &[f64],
        scale: f64,
    ) {
        let squares = squares(errors, spreads, scale);
        let pairs = spreads.par_iter_mut().zip(&self.nearest);
        pairs.for_each(|(spread, near)| *spread *= roughness(near, &squares, p_inlier));
    }

    /// The likelihood ratio of each point's agreement with its neighbours if it lies with them on one surface, over an
    /// outlier with an error of this scale.
    fn agreement(&self, values: &[f64], p_inlier: &[f64], outlier_scale: f64) -> Vec<f64> {
        let steepest = self.steepest(values, p_inlier);
        let ratio = |(near, value): (&Vec<(f64, usize)>, &f64)| {
            let slope = |(distance, j): (f64, usize)| (value - values[j]).abs() / distance;
            agreement(near, slope, steepest, outlier_scale)
        };
        self.nearest.par_iter().zip(values).map(ratio).collect()
    }

    /// The steepest slope between neighbours that agree.
    fn steepest(&self, values: &[f64], p_inlier: &[f64]) -> f64 {
        /// Relative to the median slope.
        const STEEPEST: f64 = 1.5;
        let pairs = self.nearest.iter().enumerate().flat_map(|(i, near)| {
            let pair = move |&(distance, j): &(f64, usize)| {
                let slope = (values[i] - values[j]).abs() / distance;
                (slope, p_inlier[i] * p_inlier[j])
            };
            near.iter().map(pair)
        });
        STEEPEST * weighted_median(pairs.collect())
    }
}

/// The squared errors in units of their spreads times a scale.
fn squares(errors: &[f64], spreads: &[f64], scale: f64) -> Vec<f64> {
    /// Larger squares belong to points that only seem to be inliers.
    const MOST: f64 = 64.0;
    let pairs = errors.par_iter().zip(spreads);
    pairs
        .map(|(e, s)| (e / (s * scale)).powi(2).min(MOST))
        .collect()
}

/// Returns the size of the errors of some neighbours relative to those of all points.
fn roughness(near: &[(f64, usize)], squares: &[f64], p_inlier: &[f64]) -> f64 {
    /// Weight of the average of all points, as a number of neighbours.
    const PRIOR: f64 = 3.0;
    /// Smaller than the exponent 0.5 of standard deviations, because the errors have heavy tails.
    const POWER: f64 = 0.3;
    let (mut sum, mut count) = (PRIOR, PRIOR);
    for &(_, j) in near {
        sum += p_inlier[j] * squares[j];
        count += p_inlier[j];
    }
    (sum / count).powf(POWER)
}

/// The likelihood ratio of the number of neighbours that agree with a point if it lies with them on one surface, over an
/// outlier with an error of this scale. They agree if the slope to them is no steeper than is usual among neighbours that
/// are inliers. A point that agrees with none lies alone.
fn agreement(
    near: &[(f64, usize)],
    slope: impl Fn((f64, usize)) -> f64,
    steepest: f64,
    outlier_scale: f64,
) -> f64 {
    /// The probability that a neighbour lies on the same surface.
    const SAME: f64 = 0.4;
    /// The least probability that an outlier agrees by chance.
    const CHANCE: f64 = 0.02;
    let agreeing = near.iter().filter(|near| slope(**near) <= steepest);
    let agreeing = agreeing.count();
    if agreeing == 0 {
        return 0.0;
    }
    let reach = near.iter().map(|near| near.0).sum::<f64>() / near.len() as f64;
    let chance = (2.0 * steepest * reach / (12.0_f64.sqrt() * outlier_scale)).clamp(CHANCE, SAME);
    let others = (1.0 - SAME) / (1.0 - chance);
    (SAME / chance).powi(agreeing as i32) * others.powi((near.len() - agreeing) as i32)
}
