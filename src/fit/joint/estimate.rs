//! The fit of one image to its points.

use super::JointProblem;
use crate::error::{Error, Result};
use crate::field::Field;
use crate::fit::lstsq::{Moments, Solution};
use crate::fit::points::Rows;
use crate::fit::prior::Prior;
use crate::fit::scene::{Scene, Smooth};
use crate::fit::{Estimate, Lambda};
use faer::Mat;

/// What a joint fit finds.
pub(in crate::fit) struct Joint {
    pub(in crate::fit) estimate: Estimate,
    pub(in crate::fit) smooth: Smooth,
    /// The field at each point.
    pub(in crate::fit) at_points: Vec<f64>,
}

/// Points as the field sees them: those of one of its pixels are one.
struct Sites {
    pixels: Vec<u32>,
    /// The site of each point.
    of_points: Vec<usize>,
    weights: Vec<f64>,
    /// Base functions and depth, averaged.
    rows: Vec<f64>,
}

/// Fits a field, and base functions with it if there is a prior over their weights.
pub(in crate::fit) fn solve(
    rows: &Rows<'_>,
    weights: &[f64],
    scene: Scene<'_>,
    data: f64,
    prior: Option<(&Prior, Lambda)>,
) -> Result<Joint> {
    let sites = Sites::new(rows, weights, scene, data)?;
    let columns = rows.columns();
    let problem = JointProblem {
        grid: scene.edges.grid(),
        pixels: &sites.pixels,
        weights: &sites.weights,
        rows: &sites.rows,
    };
    let field = problem.field().ok_or_else(|| {
        Error::fit("the field cannot be solved").hint("edges or depths are not finite")
    })?;
    let estimate = match prior {
        None => nothing(columns),
        Some((prior, lambda)) => {
            let moments = moments(&field, columns, sites.pixels.len());
            moments.shrunk(prior, lambda)?
        }
    };
    let mut rest: Vec<f64> = estimate.solution.weights.iter().map(|w| -w).collect();
    rest.push(1.0);
    let values = field.extend(&rest);
    let at_points = sites.of_points.iter();
    let at_points = at_points.map(|&site| values[sites.pixels[site] as usize]);
    Ok(Joint {
        at_points: at_points.collect(),
        smooth: Smooth::new(scene.edges.size(), &values),
        estimate,
    })
}

/// The field alone.
fn nothing(columns: usize) -> Estimate {
    Estimate {
        solution: Solution {
            weights: vec![0.0; columns],
            rank: 0,
            factor: Mat::zeros(columns, 0),
        },
        noise: 0.0,
        lambda: None,
    }
}

/// The field's precision takes the place of the identity in the normal equations (generalised least
/// squares, Aitken 1935). Its level is free, which takes one degree of freedom.
fn moments(field: &Field, columns: usize, count: usize) -> Moments {
    let all = field.moments();
    Moments {
        normal: Mat::from_fn(columns, columns, |i, j| all[(i.max(j), i.min(j))]),
        right: (0..columns).map(|i| all[(columns, i)]).collect(),
        square: all[(columns, columns)],
        count: count.saturating_sub(1),
    }
}

impl Sites {
    fn new(rows: &Rows<'_>, weights: &[f64], scene: Scene<'_>, data: f64) -> Result<Self> {
        let places = rows.places.ok_or_else(|| {
            Error::fit("a field cannot be fitted to points whose places are unknown")
        })?;
        let columns = rows.columns();
        let width = columns + 1;
        let mut order: Vec<(u32, usize)> = places
            .iter()
            .enumerate()
            .filter(|(i, _)| weights[*i] > 0.0)
            .map(|(i, &place)| (scene.edges.pixel(place, scene.size), i))
            .collect();
        order.sort_unstable();
        let mut sites = Self {
            pixels: Vec::new(),
            of_points: vec![0; places.len()],
            weights: Vec::new(),
            rows: Vec::with_capacity(order.len() * width),
        };
        for points in order.chunk_by(|a, b| a.0 == b.0) {
            let total: f64 = points.iter().map(|&(_, i)| weights[i]).sum();
            let start = sites.rows.len();
            sites.rows.resize(start + width, 0.0);
            for &(_, i) in points {
                sites.of_points[i] = sites.pixels.len();
                let share = weights[i] / total;
                let row = &rows.bases[i * columns..][..columns];
                let sums = &mut sites.rows[start..];
                for (sum, &value) in sums.iter_mut().zip(row) {
                    *sum += share * f64::from(value);
                }
                sums[columns] += share * rows.values[i];
            }
            sites.pixels.push(points[0].0);
            sites.weights.push(data * total);
        }
        Ok(sites)
    }
}
