//! Points judged by one another, whatever is fitted to them.

use super::local::Local;
use super::medians::{deviation, median};
use super::mixture::{Evidence, Judgement, judge as judge_all};
use super::refit::Refit;
use super::reweighted::reweighted;
use super::{Loss, Robust};
use crate::error::Result;
use crate::field::MOST;
use crate::fit::joint::FieldEstimator;
use crate::fit::points::Rows;
use crate::fit::{Estimate, Estimator};
use crate::nearest::Cells;
use rayon::prelude::*;

/// More points than this are judged by the field alone.
const CLOSE: usize = 10_000;

/// Judges each point by the others. `plain` is the fit to all of them.
///
/// # Errors
/// Equations that cannot be solved.
pub(in crate::fit) fn judge(
    rows: &Rows<'_>,
    estimator: Estimator<'_>,
    plain: &Estimate,
) -> Result<Vec<Judgement>> {
    match estimator {
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
                return Ok(Judgement::unknown(&points));
            }
            // A fit of few functions to all points cannot tell right ones from wrong ones.
            let cauchy = Robust::new(Loss::Cauchy);
            let (_, weights) = reweighted(rows, estimator, plain.clone(), cauchy)?;
            let start: Vec<f64> = weights.iter().map(|weight| weight.recip()).collect();
            judge_all(&points, &start, &Refit { rows, estimator })
        }
    }
}

/// Judges points in an order that does not depend on the one in which they are given.
fn in_order(
    rows: &Rows<'_>,
    judge: impl Fn(&[usize]) -> Result<Vec<Judgement>>,
) -> Result<Vec<Judgement>> {
    let places = rows.places.unwrap_or_default();
    let mut order: Vec<usize> = (0..places.len()).collect();
    let key = |i: usize| [places[i][1], places[i][0], rows.values[i], rows.weights[i]];
    order.par_sort_by(|&a, &b| {
        let keys = key(a).into_iter().zip(key(b));
        let unlike = keys.map(|(a, b)| a.total_cmp(&b)).find(|o| o.is_ne());
        unlike.unwrap_or(a.cmp(&b))
    });
    let mut judged: Vec<_> = order.iter().copied().zip(judge(&order)?).collect();
    judged.par_sort_by_key(|(i, _)| *i);
    Ok(judged.into_iter().map(|(_, judgement)| judgement).collect())
}

/// The field alone predicts each of very many points from those next to it; what basis functions say, they say of
/// all.
fn close(
    rows: &Rows<'_>,
    order: &[usize],
    field: FieldEstimator<'_>,
    plain: &Estimate,
) -> Result<Vec<Judgement>> {
    /// Smaller differences, relative to depth, may be due to the unit in which depths are stored.
    const ROUNDING: f64 = 1e-3;
    let points = evidence(rows, order, field.joint.data);
    let rests = rows.residuals(&plain.solution.weights);
    let rests = order.iter().map(|&i| rests[i]).collect();
    let zeros = vec![0.0; order.len()];
    let places = points.places.as_deref().unwrap_or_default();
    let rests = rows.alone(order, places, rests, &zeros);
    let estimator = Estimator::Field(FieldEstimator {
        prior: None,
        ridges: &[],
        ..field
    });
    // A mean of many cannot tell the right ones from the wrong ones, a median can.
    let off = off_neighbours(&rests);
    let scale = deviation(&off).max(ROUNDING * points.unit);
    let pairs = points.noise.iter().zip(&off);
    let start: Vec<f64> = pairs
        .map(|(noise, off)| noise * (1.0 + (off / scale).powi(2)))
        .collect();
    let rows = &rests;
    judge_all(&points, &start, &Refit { rows, estimator })
}

/// Each value minus the median of its neighbours'.
fn off_neighbours(rows: &Rows<'_>) -> Vec<f64> {
    const COUNT: usize = 8;
    let places = rows.places.unwrap_or_default();
    let cells = Cells::new(places);
    let pairs = places.par_iter().zip(&rows.values).enumerate();
    let off = pairs.map(|(i, (&place, value))| {
        let near = cells.nearest(place, COUNT + 1).into_iter();
        let others = near.filter(|(_, j)| *j != i).take(COUNT);
        value - median(others.map(|(_, j)| rows.values[j]))
    });
    off.collect()
}

/// Points are predicted by the nearest of those in their block, which is as large as covariances are cheap for.
fn by_covariances(
    rows: &Rows<'_>,
    order: &[usize],
    field: FieldEstimator<'_>,
    lambda: Option<f64>,
) -> Result<Vec<Judgement>> {
    let points = evidence(rows, order, field.joint.data);
    let places = points.places.as_deref().unwrap_or_default();
    let mut blocks = Vec::new();
    split((0..places.len()).collect(), places, &mut blocks);
    let covariance = |block: &[usize]| {
        let block: Vec<usize> = block.iter().map(|&i| order[i]).collect();
        field.covariance(rows, &block, lambda)
    };
    let local = Local::new(&points.values, places, &blocks, covariance)?;
    judge_all(&points, &points.noise, &local)
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
