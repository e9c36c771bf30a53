//! Linear interpolation over the Delaunay triangulation of the points; nearest point outside
//! their hull. The honest baseline of the field.

use super::neighbours::Neighbours;
use crate::error::Result;
use delaunator::triangulate;
use lsdc_core::{DepthMap, Point};

pub(super) fn linear(sparse: &DepthMap) -> Result<DepthMap> {
    let neighbours = Neighbours::new(sparse);
    let points = &neighbours.points;
    let (width, height) = (sparse.width(), sparse.height());
    let mut values = vec![f32::NAN; width * height];
    let corners: Vec<_> = points
        .iter()
        .map(|p| delaunator::Point {
            x: p.x as f64,
            y: p.y as f64,
        })
        .collect();
    for triangle in triangulate(&corners).triangles.chunks_exact(3) {
        fill(
            &mut values,
            width,
            std::array::from_fn(|i| points[triangle[i]]),
        );
    }
    for (i, value) in values.iter_mut().enumerate() {
        if value.is_nan() {
            let (_, nearest) = neighbours.nearest(i % width, i / width, 1)[0];
            *value = points[nearest].depth;
        }
    }
    Ok(DepthMap::new(width, height, values)?)
}

/// Interpolates the pixels inside a triangle, edges included.
fn fill(values: &mut [f32], width: usize, [a, b, c]: [Point; 3]) {
    let edge = |p: Point, q: Point, x: f64, y: f64| {
        (q.x as f64 - p.x as f64) * (y - p.y as f64) - (q.y as f64 - p.y as f64) * (x - p.x as f64)
    };
    let area = edge(a, b, c.x as f64, c.y as f64);
    if area == 0.0 {
        return;
    }
    let (left, right) = (a.x.min(b.x).min(c.x), a.x.max(b.x).max(c.x));
    let (top, bottom) = (a.y.min(b.y).min(c.y), a.y.max(b.y).max(c.y));
    for y in top..=bottom {
        for x in left..=right {
            let (px, py) = (x as f64, y as f64);
            let u = edge(b, c, px, py) / area;
            let v = edge(c, a, px, py) / area;
            let w = 1.0 - u - v;
            if u >= -1e-9 && v >= -1e-9 && w >= -1e-9 {
                let depth =
                    u * f64::from(a.depth) + v * f64::from(b.depth) + w * f64::from(c.depth);
                values[y * width + x] = depth as f32;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plane_is_reproduced_inside_the_hull() {
        let plane = |x: usize, y: usize| 2.0 + 0.01 * x as f32 + 0.02 * y as f32;
        let mut points = vec![];
        for (x, y) in [
            (0, 0),
            (39, 0),
            (0, 29),
            (39, 29),
            (11, 7),
            (25, 20),
            (30, 5),
        ] {
            points.push(Point {
                x,
                y,
                depth: plane(x, y),
            });
        }
        let dense = linear(&DepthMap::from_points(40, 30, &points)).unwrap();
        for y in 0..30 {
            for x in 0..40 {
                assert!((dense.at(x, y) - plane(x, y)).abs() < 1e-5, "{x} {y}");
            }
        }
    }
}
