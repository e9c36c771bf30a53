//! Points judged by one another, whatever is fitted to them.

use super::local::Local;
use super::mixture::{Evidence, Judgement, judge as judge_all};
use super::refit::Refit;
use super::reweighted::reweighted;
use super::{Loss, Robust};
use crate::error::Result;
use crate::field::MOST;
use crate::fit::joint::FieldEstimator;
use crate::fit::points::Rows;
use crate::fit::{Estimate, Estimator};
use rayon::prelude::*;

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
        Estimator::Field(field) => in_blocks(rows, field, plain.lambda),
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

/// Points near one another, as many as covariances are cheap for, at a time.
fn in_blocks(
    rows: &Rows<'_>,
    field: FieldEstimator<'_>,
    lambda: Option<f64>,
) -> Result<Vec<Judgement>> {
    let places = rows.places.unwrap_or_default();
    // The order in which points are given does not matter.
    let mut order: Vec<usize> = (0..places.len()).collect();
    let key = |i: usize| [places[i][1], places[i][0], rows.values[i], rows.weights[i]];
    order.sort_by(|&a, &b| {
        let keys = key(a).into_iter().zip(key(b));
        let unlike = keys.map(|(a, b)| a.total_cmp(&b)).find(|o| o.is_ne());
        unlike.unwrap_or(a.cmp(&b))
    });
    let mut blocks = Vec::new();
    split(order, places, &mut blocks);
    let judged: Vec<Result<Vec<Judgement>>> = blocks
        .par_iter()
        .map(|block| {
            let points = evidence(rows, block, field.joint.data);
            let covariance = field.covariance(rows, block, lambda)?;
            let own: Vec<[f64; 2]> = block.iter().map(|&i| places[i]).collect();
            let local = Local::new(&points.values, &own, &covariance);
            judge_all(&points, &points.noise, &local)
        })
        .collect();
    let mut all = vec![None; places.len()];
    for (block, judged) in blocks.iter().zip(judged) {
        for (&i, judgement) in block.iter().zip(judged?) {
            all[i] = Some(judgement);
        }
    }
    Ok(all.into_iter().flatten().collect())
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
