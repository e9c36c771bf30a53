//! The outlier test: points are predicted from each other by any estimator.

use super::local::LocalKriging;
use super::mixture::{
    InlierPosterior, NearestPoints, TestedPoints, test_outliers, test_outliers_in_two_stages,
    test_outliers_with,
};
use super::refit::Refit;
use super::reweighted::reweighted;
use super::{Loss, Robust};
use crate::error::Result;
use crate::field::MOST;
use crate::fit::blocks::Blocks;
use crate::fit::estimate::Estimate;
use crate::fit::estimator::Estimator;
use crate::fit::joint::FieldEstimator;
use crate::fit::medians::deviation;
use crate::fit::points::{FitRows, lexicographic};
use rayon::prelude::*;

/// Largest number of points that are predicted by the full model; more are predicted by the field alone.
const CLOSE: usize = 10_000;

/// Least number of points, and of points per pixel of the field, for which a sample predicts all points by a field of blocks of
/// pixels. With fewer points per pixel, errors next to edges would have more effect.
const DENSE: usize = 30_000;
const EACH: usize = 3;
/// Size of the sample, and number of blocks.
const SAMPLE: usize = 20_000;
const BLOCKS: usize = 5000;

/// Tests each point by the others. `plain` is the fit to all of them.
///
/// # Errors
/// Equations that cannot be solved.
pub(in crate::fit) fn inlier_posteriors(
    rows: &FitRows<'_>,
    estimator: Estimator<'_>,
    plain: &Estimate,
) -> Result<Vec<InlierPosterior>> {
    match estimator {
        Estimator::Field(field) if is_dense(rows, field) => dense(rows, field, plain),
        Estimator::Field(field) => in_order(rows, |order| {
            if order.len() > CLOSE {
                close(rows, order, field, plain)
            } else {
                by_covariances(rows, order, field, plain.lambda)
            }
        }),
        Estimator::Plain(_) | Estimator::Shrunk(..) => {
            let all: Vec<usize> = (0..rows.values.len()).collect();
            let points = tested_points(rows, &all, 1.0);
            if all.len() <= plain.solution.rank {
                // A fit that interpolates every point cannot predict one from the others.
                return Ok(InlierPosterior::unknown(&points.noise));
            }
            // A fit of few functions to all points does not separate inliers from outliers.
            let cauchy = Robust::new(Loss::Cauchy);
            let (_, weights) = reweighted(rows, estimator, plain.clone(), cauchy)?;
            let start: Vec<f64> = weights.iter().map(|weight| weight.recip()).collect();
            Ok(test_outliers(&points, &start, &Refit::new(rows, estimator))?.posteriors())
        }
    }
}

fn is_dense(rows: &FitRows<'_>, field: FieldEstimator<'_>) -> bool {
    let (height, width) = field.geometry.affinities.size();
    rows.values.len() >= DENSE.max(EACH * height * width)
}

/// Tests points in an order that does not depend on the one in which they are given.
fn in_order(
    rows: &FitRows<'_>,
    posteriors: impl Fn(&[usize]) -> Result<Vec<InlierPosterior>>,
) -> Result<Vec<InlierPosterior>> {
    let mut order: Vec<usize> = (0..rows.values.len()).collect();
    sort(rows, &mut order);
    let mut found: Vec<_> = order.iter().copied().zip(posteriors(&order)?).collect();
    found.par_sort_by_key(|(i, _)| *i);
    Ok(found.into_iter().map(|(_, posterior)| posterior).collect())
}

/// Sorts points by their position, value and weight.
fn sort(rows: &FitRows<'_>, points: &mut [usize]) {
    points.par_sort_by(|&a, &b| lexicographic(key(rows, a), key(rows, b)).then(a.cmp(&b)));
}

/// The sort key of a point.
fn key(rows: &FitRows<'_>, i: usize) -> [f64; 4] {
    let [u, v] = rows.places.map_or([0.0; 2], |places| places[i]);
    [v, u, rows.values[i], rows.weights[i]]
}

/// With very many points, the field alone predicts each from its neighbours, which share the basis functions. The field of
/// blocks of pixels, which is fast, finds most outliers first.
fn close(
    rows: &FitRows<'_>,
    order: &[usize],
    field: FieldEstimator<'_>,
    plain: &Estimate,
) -> Result<Vec<InlierPosterior>> {
    let residuals = rows.residuals(&plain.solution.weights);
    let points = tested_points(rows, order, field.joint.observation_precision);
    let zeros = vec![0.0; order.len()];
    let rows = rows.with_values(order, places(&points), &residuals, &zeros);
    let field = field.without_functions();
    let fine = field.geometry.affinities;
    let blocks = Blocks::new(fine.size(), BLOCKS);
    let coarse = fine.for_blocks(blocks);
    let refit = |field| Refit::new(&rows, Estimator::Field(field));
    let rough = refit(field.on(&coarse, blocks.area()));
    let (neighbours, start) = neighbours_and_noise(&points, &rows.values);
    let test = test_outliers_in_two_stages(&points, neighbours, &start, &rough, &refit(field))?;
    Ok(test.posteriors())
}

/// If points are dense, tests a sample by a field of blocks of pixels, which then predicts all others.
fn dense(
    rows: &FitRows<'_>,
    field: FieldEstimator<'_>,
    plain: &Estimate,
) -> Result<Vec<InlierPosterior>> {
    let residuals = rows.residuals(&plain.solution.weights);
    let (mut sampled, others) = sample(rows);
    sort(rows, &mut sampled);
    let points = tested_points(rows, &sampled, field.joint.observation_precision);
    let zeros = vec![0.0; sampled.len()];
    let own = rows.with_values(&sampled, places(&points), &residuals, &zeros);
    let fine = field.geometry.affinities;
    let blocks = Blocks::new(fine.size(), BLOCKS);
    let coarse = fine.for_blocks(blocks);
    let field = field.without_functions().on(&coarse, blocks.area());
    let refit = Refit::new(&own, Estimator::Field(field));
    let (neighbours, start) = neighbours_and_noise(&points, &own.values);
    let test = test_outliers_with(&points, neighbours, &start, &refit)?;

    let points = tested_points(rows, &others, field.joint.observation_precision);
    let read =
        |(&place, &i): (&[f64; 2], &usize)| (field.geometry.interpolation(place), residuals[i]);
    let pairs = places(&points).par_iter().zip(&others).map(read);
    let found = refit.others(test.noise(), pairs)?;
    let mut all = InlierPosterior::unknown(&rows.weights);
    let both = sampled.into_iter().zip(test.posteriors());
    for (i, posterior) in both.chain(others.into_iter().zip(test.others(&points, &found))) {
        all[i] = posterior;
    }
    Ok(all)
}

/// A random sample of the points, and the others, which depends neither on the order in which they are given nor on the
/// unit of their values.
fn sample(rows: &FitRows<'_>) -> (Vec<usize>, Vec<usize>) {
    let mark = |i: usize| {
        let place = rows.places.map_or([0.0; 2], |places| places[i]);
        let place = lsdc_rng::hash(&place.map(f64::to_le_bytes));
        // Depths are positive, so the order of their bits is that of their values.
        (place, rows.values[i].to_bits(), i)
    };
    let mut marks: Vec<_> = (0..rows.values.len()).into_par_iter().map(mark).collect();
    marks.select_nth_unstable(SAMPLE);
    let mut sampled: Vec<usize> = marks.into_iter().map(|(.., i)| i).collect();
    let mut others = sampled.split_off(SAMPLE);
    others.par_sort_unstable();
    (sampled, others)
}

fn places(points: &TestedPoints) -> &[[f64; 2]] {
    points.places.as_deref().unwrap_or_default()
}

/// The neighbours of points, and the variances of noise of the first predictions, from the residuals of basis functions.
fn neighbours_and_noise(points: &TestedPoints, residuals: &[f64]) -> (NearestPoints, Vec<f64>) {
    /// Smaller differences, relative to depth, may be due to the unit in which depths are stored.
    const ROUNDING: f64 = 1e-3;
    // Outliers bias the mean of neighbours, but not the median.
    let neighbours = NearestPoints::new(points);
    let differences = neighbours.differences(residuals);
    let scale = deviation(&differences).max(ROUNDING * points.unit);
    let pairs = points.noise.iter().zip(&differences);
    let start = pairs.map(|(noise, difference)| noise * (1.0 + (difference / scale).powi(2)));
    (neighbours, start.collect())
}

/// Predicts points by the nearest points in their block, which is as large as the cost of covariances allows.
fn by_covariances(
    rows: &FitRows<'_>,
    order: &[usize],
    field: FieldEstimator<'_>,
    lambda: Option<f64>,
) -> Result<Vec<InlierPosterior>> {
    let points = tested_points(rows, order, field.joint.observation_precision);
    let places = places(&points);
    let mut blocks = Vec::new();
    split((0..places.len()).collect(), places, &mut blocks);
    let covariance = |block: &[usize]| {
        let block: Vec<usize> = block.iter().map(|&i| order[i]).collect();
        field.covariance(rows, &block, lambda)
    };
    let local = LocalKriging::new(&points.values, places, &blocks, covariance)?;
    Ok(test_outliers(&points, &points.noise, &local)?.posteriors())
}

/// Halves points across their longer side until there are few enough.
fn split(mut points: Vec<usize>, places: &[[f64; 2]], blocks: &mut Vec<Vec<usize>>) {
    if points.len() <= MOST {
        blocks.push(points);
        return;
    }
    let extent = |axis: usize| {
        let along = || points.iter().map(|&i| places[i][axis]);
        along().fold(f64::NEG_INFINITY, f64::max) - along().fold(f64::INFINITY, f64::min)
    };
    let axis = usize::from(extent(1) > extent(0));
    points.sort_by(|&a, &b| places[a][axis].total_cmp(&places[b][axis]));
    let rest = points.split_off(points.len() / 2);
    split(points, places, blocks);
    split(rest, places, blocks);
}

/// Returns points with the noise variance `1 / (observation_precision x weight)`.
fn tested_points(rows: &FitRows<'_>, which: &[usize], observation_precision: f64) -> TestedPoints {
    TestedPoints {
        values: which.iter().map(|&i| rows.values[i]).collect(),
        noise: which
            .iter()
            .map(|&i| (observation_precision * rows.weights[i]).recip())
            .collect(),
        places: rows
            .places
            .map(|places| which.iter().map(|&i| places[i]).collect()),
        unit: rows.unit(),
    }
}
