//! Linear interpolation over the Delaunay triangulation of the points; nearest point outside
//! their hull. The honest baseline of the field.

use crate::data::{DepthMap, Point};
use crate::error::{Error, Result};
use delaunator::triangulate;

/// Fills every pixel of the map.
///
/// # Errors
/// No point.
pub fn linear(sparse: &DepthMap) -> Result<DepthMap> {
    let points: Vec<Point> = sparse.points().collect();
    if points.is_empty() {
        return Err(Error::fit("there is no sparse depth to interpolate")
            .hint("give at least one pixel a positive, finite depth"));
    }
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
    let nearest = Nearest::new(&points, width, height);
    for (i, value) in values.iter_mut().enumerate() {
        if value.is_nan() {
            *value = nearest.depth(i % width, i / width);
        }
    }
    DepthMap::new(width, height, values)
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

/// Points in square cells, for nearest-point queries.
struct Nearest<'a> {
    points: &'a [Point],
    cells: Vec<Vec<usize>>,
    side: usize,
    columns: usize,
    rows: usize,
}

impl<'a> Nearest<'a> {
    fn new(points: &'a [Point], width: usize, height: usize) -> Self {
        let side = (((width * height) as f64 / points.len() as f64).sqrt() as usize).max(1);
        let (columns, rows) = (width.div_ceil(side), height.div_ceil(side));
        let mut cells = vec![Vec::new(); columns * rows];
        for (i, p) in points.iter().enumerate() {
            cells[p.y / side * columns + p.x / side].push(i);
        }
        Self {
            points,
            cells,
            side,
            columns,
            rows,
        }
    }

    /// The depth of the nearest point; the first in row order among equals.
    fn depth(&self, x: usize, y: usize) -> f32 {
        let (column, row) = (x / self.side, y / self.side);
        let mut best: Option<(usize, usize)> = None;
        for ring in 0..self.columns.max(self.rows) {
            // Every point of a later ring is at least this far away.
            let closest = ring.saturating_sub(1) * self.side;
            if best.is_some_and(|(distance, _)| distance < closest * closest) {
                break;
            }
            for r in row.saturating_sub(ring)..(row + ring + 1).min(self.rows) {
                for c in column.saturating_sub(ring)..(column + ring + 1).min(self.columns) {
                    if r.abs_diff(row).max(c.abs_diff(column)) != ring {
                        continue;
                    }
                    for &i in &self.cells[r * self.columns + c] {
                        let p = &self.points[i];
                        let distance = p.x.abs_diff(x).pow(2) + p.y.abs_diff(y).pow(2);
                        best = Some(best.map_or((distance, i), |b| b.min((distance, i))));
                    }
                }
            }
        }
        best.map_or(0.0, |(_, i)| self.points[i].depth)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Rng;

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

    #[test]
    fn outside_the_hull_the_nearest_point_counts() {
        let mut rng = Rng::stream(1, &["nearest"]);
        let points: Vec<Point> = (0..20)
            .map(|i| Point {
                x: rng.below(60) as usize,
                y: rng.below(40) as usize,
                depth: 1.0 + i as f32,
            })
            .collect();
        let map = DepthMap::from_points(60, 40, &points);
        let points: Vec<Point> = map.points().collect();
        let nearest = Nearest::new(&points, 60, 40);
        for y in 0..40 {
            for x in 0..60 {
                let distance = |p: &&Point| p.x.abs_diff(x).pow(2) + p.y.abs_diff(y).pow(2);
                let expected = points.iter().min_by_key(distance).unwrap();
                assert_eq!(nearest.depth(x, y), expected.depth);
            }
        }
    }

    #[test]
    fn one_point_fills_the_map() {
        let map = DepthMap::from_points(
            5,
            4,
            &[Point {
                x: 2,
                y: 1,
                depth: 3.0,
            }],
        );
        assert!(linear(&map).unwrap().values().iter().all(|v| *v == 3.0));
        assert!(linear(&DepthMap::empty(5, 4)).is_err());
    }
}
