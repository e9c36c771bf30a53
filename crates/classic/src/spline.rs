//! Thin-plate splines (Duchon 1977): the interpolating surface with the smallest bending energy.
//!
//! For many points, splines of overlapping neighbourhoods are blended (partition of unity), so that the time grows with the
//! number of points and not with its cube.

use super::neighbours::{Neighbours, each_pixel};
use crate::error::{Error, Result};
use faer::Mat;
use faer::linalg::solvers::Solve as _;
use lsdc_core::{DepthMap, Point};
use rayon::prelude::*;

/// Largest number of points for a single spline; otherwise each neighbourhood has a quarter of this.
const WHOLE: usize = 1024;

pub(super) fn spline(sparse: &DepthMap) -> Result<DepthMap> {
    let neighbours = Neighbours::new(sparse);
    let points = &neighbours.points;
    if points.len() <= WHOLE {
        let spline = Spline::through(points)?;
        return each_pixel(sparse, |x, y| spline.at(x, y));
    }
    let part = WHOLE / 4;
    // Squares with about a quarter of a neighbourhood's points each.
    let area = (sparse.width() * sparse.height()) as f64;
    let side = (area * part as f64 / points.len() as f64 / 4.0)
        .sqrt()
        .max(2.0);
    let count = |length: usize| (length as f64 / side).ceil() as usize + 1;
    let (columns, rows) = (count(sparse.width()), count(sparse.height()));
    let splines: Vec<Spline> = (0..columns * rows)
        .into_par_iter()
        .map(|i| {
            let corner = |i: usize, length: usize| ((i as f64 * side) as usize).min(length - 1);
            let x = corner(i % columns, sparse.width());
            let y = corner(i / columns, sparse.height());
            let nearest = neighbours.nearest(x, y, part).into_iter();
            let nearest: Vec<Point> = nearest.map(|(_, i)| points[i]).collect();
            Spline::through(&nearest)
        })
        .collect::<Result<_>>()?;
    each_pixel(sparse, |x, y| {
        let (u, v) = (x as f64 / side, y as f64 / side);
        let (column, row) = (u as usize, v as usize);
        let (u, v) = (u.fract(), v.fract());
        [
            (0, 0, (1.0 - u) * (1.0 - v)),
            (1, 0, u * (1.0 - v)),
            (0, 1, (1.0 - u) * v),
            (1, 1, u * v),
        ]
        .into_iter()
        .map(|(dx, dy, weight)| {
            weight * f64::from(splines[(row + dy) * columns + column + dx].at(x, y))
        })
        .sum::<f64>() as f32
    })
}

/// Radial functions at the points and a plane.
struct Spline {
    centres: Vec<[f64; 2]>,
    weights: Vec<f64>,
    plane: [f64; 3],
    /// The range of the points' depths: a plane through few points may extrapolate far beyond this range.
    range: (f64, f64),
}

impl Spline {
    fn through(points: &[Point]) -> Result<Self> {
        let depths = points.iter().map(|p| f64::from(p.depth));
        let range = depths.fold((f64::INFINITY, 0.0_f64), |(low, high), depth| {
            (low.min(depth), high.max(depth))
        });
        let centres: Vec<[f64; 2]> = points.iter().map(|p| [p.x as f64, p.y as f64]).collect();
        let n = points.len();
        // Collinear points do not determine the plane: a ridge penalty selects the smallest slope.
        let tilt = 1e-9;
        let matrix = Mat::from_fn(n + 3, n + 3, |i, j| match (i < n, j < n) {
            (true, true) => radial(centres[i], centres[j]),
            (true, false) => monomial(centres[i], j - n),
            (false, true) => monomial(centres[j], i - n),
            (false, false) => -tilt * f64::from(i == j),
        });
        let right_hand_side = Mat::from_fn(n + 3, 1, |i, _| {
            points.get(i).map_or(0.0, |p| f64::from(p.depth))
        });
        let solution = matrix.partial_piv_lu().solve(&right_hand_side);
        let solution = solution.col_as_slice(0);
        if solution.iter().any(|v| !v.is_finite()) {
            return Err(Error::Spline);
        }
        Ok(Self {
            centres,
            weights: solution[..n].to_vec(),
            plane: [solution[n], solution[n + 1], solution[n + 2]],
            range,
        })
    }

    fn at(&self, x: usize, y: usize) -> f32 {
        let place = [x as f64, y as f64];
        let plane: f64 = (0..3).map(|i| self.plane[i] * monomial(place, i)).sum();
        let terms = self.centres.iter().zip(&self.weights);
        let terms = terms.map(|(centre, weight)| weight * radial(*centre, place));
        let (low, high) = self.range;
        let margin = high - low;
        let value = plane + terms.sum::<f64>();
        value.clamp((low - margin).max(0.5 * low), high + margin) as f32
    }
}

/// Returns r^2 ln r for the distance r between two positions, in hundreds of pixels.
fn radial(a: [f64; 2], b: [f64; 2]) -> f64 {
    let square = 1e-4 * ((a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2));
    if square == 0.0 {
        0.0
    } else {
        0.5 * square * square.ln()
    }
}

fn monomial(place: [f64; 2], i: usize) -> f64 {
    match i {
        0 => 1.0,
        _ => 1e-2 * place[i - 1],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsdc_rng::Rng;

    fn scattered(count: usize, depth: impl Fn(f32, f32) -> f32) -> DepthMap {
        let mut rng = Rng::stream(2, &["spline"]);
        let points: Vec<Point> = (0..count)
            .map(|_| (rng.below(120) as usize, rng.below(90) as usize))
            .map(|(x, y)| Point {
                x,
                y,
                depth: depth(x as f32, y as f32),
            })
            .collect();
        DepthMap::from_points(120, 90, &points)
    }

    #[test]
    fn a_plane_is_reproduced_and_points_are_met() {
        let plane = |x: f32, y: f32| 2.0 + 0.01 * x + 0.02 * y;
        let dense = spline(&scattered(60, plane)).unwrap();
        for y in 0..90 {
            for x in 0..120 {
                assert!((dense.at(x, y) - plane(x as f32, y as f32)).abs() < 1e-4);
            }
        }
        let bent = |x: f32, y: f32| 3.0 + (x * 0.1).sin() + (y * 0.07).cos();
        let sparse = scattered(80, bent);
        let dense = spline(&sparse).unwrap();
        assert!(
            sparse
                .points()
                .all(|p| (dense.at(p.x, p.y) - p.depth).abs() < 1e-4)
        );
    }

    #[test]
    fn blended_splines_agree_with_the_surface() {
        let bent = |x: f32, y: f32| 3.0 + (x * 0.05).sin() + (y * 0.04).cos();
        let sparse = scattered(3000, bent);
        assert!(sparse.count() > WHOLE);
        let dense = spline(&sparse).unwrap();
        for y in 3..87 {
            for x in 3..117 {
                assert!((dense.at(x, y) - bent(x as f32, y as f32)).abs() < 0.01);
            }
        }
    }
}
