//! Points judged by one another, whatever is fitted to them.

use super::local::Local;
use super::mixture::{
    Evidence, InlierPosterior, Neighbours, judge as judge_all, judge_twice, judge_with,
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
use crate::fit::points::Rows;
use rayon::prelude::*;

/// More points than this are judged by the field alone.
const CLOSE: usize = 10_000;

/// Of so many points, and so many for each pixel of the field, some judge all by a field of blocks of pixels. With fewer
/// for each pixel, what is wrong next to an edge would matter more.
const DENSE: usize = 30_000;
const EACH: usize = 3;
/// The points that judge, and the blocks.
const JUDGES: usize = 20_000;
const BLOCKS: usize = 5000;

/// Judges each point by the others. `plain` is the fit to all of them.
///
/// # Errors
/// Equations that cannot be solved.
pub(in crate::fit) fn judge(
    rows: &Rows<'_>,
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
            let points = evidence(rows, &all, 1.0);
            if all.len() <= plain.solution.rank {
                // A fit through every point: none says anything of another.
                return Ok(InlierPosterior::unknown(&points.noise));
            }
            // A fit of few functions to all points cannot tell right ones from wrong ones.
            let cauchy = Robust::new(Loss::Cauchy);
            let (_, weights) = reweighted(rows, estimator, plain.clone(), cauchy)?;
            let start: Vec<f64> = weights.iter().map(|weight| weight.recip()).collect();
            Ok(judge_all(&points, &start, &Refit::new(rows, estimator))?.judgements())
        }
    }
}

fn is_dense(rows: &Rows<'_>, field: FieldEstimator<'_>) -> bool {
    let (height, width) = field.scene.affinities.size();
    rows.values.len() >= DENSE.max(EACH * height * width)
}

/// Judges points in an order that does not depend on the one in which they are given.
fn in_order(
    rows: &Rows<'_>,
    judge: impl Fn(&[usize]) -> Result<Vec<InlierPosterior>>,
) -> Result<Vec<InlierPosterior>> {
    let mut order: Vec<usize> = (0..rows.values.len()).collect();
    sort(rows, &mut order);
    let mut judged: Vec<_> = order.iter().copied().zip(judge(&order)?).collect();
    judged.par_sort_by_key(|(i, _)| *i);
    Ok(judged.into_iter().map(|(_, judgement)| judgement).collect())
}

/// Sorts points by what they are.
fn sort(rows: &Rows<'_>, points: &mut [usize]) {
    points.par_sort_by(|&a, &b| {
        let keys = key(rows, a).into_iter().zip(key(rows, b));
        let unlike = keys.map(|(a, b)| a.total_cmp(&b)).find(|o| o.is_ne());
        unlike.unwrap_or(a.cmp(&b))
    });
}

/// What a point is.
fn key(rows: &Rows<'_>, i: usize) -> [f64; 4] {
    let [u, v] = rows.places.map_or([0.0; 2], |places| places[i]);
    [v, u, rows.values[i], rows.weights[i]]
}

/// The field alone predicts each of very many points from those next to it; what basis functions say, they say of
/// all. That of blocks of pixels, which costs little, finds most of the wrong ones first.
fn close(
    rows: &Rows<'_>,
    order: &[usize],
    field: FieldEstimator<'_>,
    plain: &Estimate,
) -> Result<Vec<InlierPosterior>> {
    let rests = rows.residuals(&plain.solution.weights);
    let points = evidence(rows, order, field.joint.data);
    let zeros = vec![0.0; order.len()];
    let rows = rows.alone(order, places(&points), &rests, &zeros);
    let field = field.without_functions();
    let fine = field.scene.affinities;
    let blocks = Blocks::new(fine.size(), BLOCKS);
    let coarse = fine.in_blocks(blocks);
    let refit = |field| Refit::new(&rows, Estimator::Field(field));
    let rough = refit(field.on(&coarse, blocks.area()));
    let (neighbours, start) = start(&points, &rows.values);
    let judged = judge_twice(&points, neighbours, &start, &rough, &refit(field))?;
    Ok(judged.judgements())
}

/// Where points are dense, some of them judge one another by a field of blocks of pixels, and then all others.
fn dense(
    rows: &Rows<'_>,
    field: FieldEstimator<'_>,
    plain: &Estimate,
) -> Result<Vec<InlierPosterior>> {
    let rests = rows.residuals(&plain.solution.weights);
    let (mut judges, others) = judges(rows);
    sort(rows, &mut judges);
    let points = evidence(rows, &judges, field.joint.data);
    let zeros = vec![0.0; judges.len()];
    let own = rows.alone(&judges, places(&points), &rests, &zeros);
    let fine = field.scene.affinities;
    let blocks = Blocks::new(fine.size(), BLOCKS);
    let coarse = fine.in_blocks(blocks);
    let field = field.without_functions().on(&coarse, blocks.area());
    let refit = Refit::new(&own, Estimator::Field(field));
    let (neighbours, start) = start(&points, &own.values);
    let judged = judge_with(&points, neighbours, &start, &refit)?;

    let points = evidence(rows, &others, field.joint.data);
    let read = |(&place, &i): (&[f64; 2], &usize)| (field.scene.taps(place), rests[i]);
    let pairs = places(&points).par_iter().zip(&others).map(read);
    let found = refit.others(judged.noise(), pairs)?;
    let mut all = InlierPosterior::unknown(&rows.weights);
    let both = judges.into_iter().zip(judged.judgements());
    for (i, judgement) in both.chain(others.into_iter().zip(judged.others(&points, &found))) {
        all[i] = judgement;
    }
    Ok(all)
}

/// Some points, and the others: a random choice, which depends neither on the order in which they are given nor on the
/// unit of their values.
fn judges(rows: &Rows<'_>) -> (Vec<usize>, Vec<usize>) {
    let mark = |i: usize| {
        let place = rows.places.map_or([0.0; 2], |places| places[i]);
        let place = lsdc_rng::hash(&place.map(f64::to_le_bytes));
        // Depths are above 0: their bits are in their order.
        (place, rows.values[i].to_bits(), i)
    };
    let mut marks: Vec<_> = (0..rows.values.len()).into_par_iter().map(mark).collect();
    marks.select_nth_unstable(JUDGES);
    let mut judges: Vec<usize> = marks.into_iter().map(|(.., i)| i).collect();
    let mut others = judges.split_off(JUDGES);
    others.par_sort_unstable();
    (judges, others)
}

fn places(points: &Evidence) -> &[[f64; 2]] {
    points.places.as_deref().unwrap_or_default()
}

/// The neighbours of points, and the variances of noise with which points predict others first, from what basis
/// functions leave of them.
fn start(points: &Evidence, rests: &[f64]) -> (Neighbours, Vec<f64>) {
    /// Smaller differences, relative to depth, may be due to the unit in which depths are stored.
    const ROUNDING: f64 = 1e-3;
    // A mean of many cannot tell the right ones from the wrong ones, a median can.
    let neighbours = Neighbours::new(points);
    let off = neighbours.off(rests);
    let scale = deviation(&off).max(ROUNDING * points.unit);
    let pairs = points.noise.iter().zip(&off);
    let start = pairs.map(|(noise, off)| noise * (1.0 + (off / scale).powi(2)));
    (neighbours, start.collect())
}

/// Points are predicted by the nearest of those in their block, which is as large as covariances are cheap for.
fn by_covariances(
    rows: &Rows<'_>,
    order: &[usize],
    field: FieldEstimator<'_>,
    lambda: Option<f64>,
) -> Result<Vec<InlierPosterior>> {
    let points = evidence(rows, order, field.joint.data);
    let places = points.places.as_deref().unwrap_or_default();
    let mut blocks = Vec::new();
    split((0..places.len()).collect(), places, &mut blocks);
    let covariance = |block: &[usize]| {
        let block: Vec<usize> = block.iter().map(|&i| order[i]).collect();
        field.covariance(rows, &block, lambda)
    };
    let local = Local::new(&points.values, places, &blocks, covariance)?;
    Ok(judge_all(&points, &points.noise, &local)?.judgements())
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

/// Points whose noise has a variance of `1 / (data x weight)`.
fn evidence(rows: &Rows<'_>, which: &[usize], data: f64) -> Evidence {
    Evidence {
        values: which.iter().map(|&i| rows.values[i]).collect(),
        noise: which
            .iter()
            .map(|&i| (data * rows.weights[i]).recip())
            .collect(),
        places: rows
            .places
            .map(|places| which.iter().map(|&i| places[i]).collect()),
        unit: rows.unit(),
        proportional: rows.is_proportional(),
    }
}
