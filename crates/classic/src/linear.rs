//! Linear interpolation of depth or inverse depth over the Delaunay triangulation of the points; nearest neighbour outside
//! their hull.

use super::neighbours::Neighbours;
use crate::error::Result;
use delaunator::triangulate;
use lsdc_core::{DepthMap, Point};

/// The quantity that is interpolated linearly.
#[derive(Clone, Copy)]
pub(super) enum Quantity {
    Depth,
    /// 1 / depth, which is linear in the pixel coordinates over a plane seen by a pinhole camera.
    Inverse,
}

impl Quantity {
    /// Converts a depth to the quantity or the quantity to a depth; the conversion is its own inverse.
    fn convert(self, depth: f64) -> f64 {
        match self {
            Self::Depth => depth,
            Self::Inverse => 1.0 / depth,
        }
    }
}

pub(super) fn linear(sparse: &DepthMap, quantity: Quantity) -> Result<DepthMap> {
    let neighbours = Neighbours::of(edge_points(sparse));
    let (width, height) = (sparse.width(), sparse.height());
    let unknown = |&depth: &f32| if depth > 0.0 { depth } else { f32::NAN };
    let mut values: Vec<f32> = sparse.values().iter().map(unknown).collect();
    for triangle in triangles(&neighbours.points) {
        fill(&mut values, sparse, triangle, quantity);
    }
    for (i, value) in values.iter_mut().enumerate() {
        if value.is_nan() {
            *value = neighbours.nearest_depth(i % width, i / width);
        }
    }
    Ok(DepthMap::new(width, height, values)?)
}

/// Returns the Delaunay triangulation.
fn triangles(points: &[Point]) -> Vec<[Point; 3]> {
    let corners = points.iter().map(|p| delaunator::Point {
        x: p.x as f64,
        y: p.y as f64,
    });
    let indices = triangulate(&corners.collect::<Vec<_>>()).triangles;
    let triangles = indices.as_chunks::<3>().0.iter();
    triangles
        .map(|corners| corners.map(|i| points[i]))
        .collect()
}

/// Returns the measurements adjacent to a pixel without one: no unmeasured pixel depends on the others. If the four pixels
/// around a measurement are measured, its Voronoi cell is its own pixel (open to the outside at the border of the image), so
/// that its Delaunay triangles lie in unit squares and cover no unmeasured pixel.
fn edge_points(sparse: &DepthMap) -> Vec<Point> {
    let is_hole = |x: usize, y: usize| sparse.get(x, y) == Some(0.0);
    let is_edge = |&Point { x, y, .. }: &Point| {
        let (left, above) = (x.wrapping_sub(1), y.wrapping_sub(1));
        [(left, y), (x + 1, y), (x, above), (x, y + 1)]
            .into_iter()
            .any(|(x, y)| is_hole(x, y))
    };
    sparse.points().filter(is_edge).collect()
}

/// Interpolates the unmeasured pixels inside a triangle, edges included.
fn fill(values: &mut [f32], sparse: &DepthMap, [a, b, c]: [Point; 3], quantity: Quantity) {
    let edge = |p: Point, q: Point, x: f64, y: f64| {
        (q.x as f64 - p.x as f64) * (y - p.y as f64) - (q.y as f64 - p.y as f64) * (x - p.x as f64)
    };
    let area = edge(a, b, c.x as f64, c.y as f64);
    if area == 0.0 {
        return;
    }
    let [at_a, at_b, at_c] = [a, b, c].map(|p| quantity.convert(f64::from(p.depth)));
    let (top, bottom) = (a.y.min(b.y).min(c.y), a.y.max(b.y).max(c.y));
    for y in top..=bottom {
        let (left, right) = row_of([a, b, c], y);
        for x in left..=right {
            let pixel = y * sparse.width() + x;
            if sparse.values()[pixel] > 0.0 {
                continue;
            }
            let (px, py) = (x as f64, y as f64);
            let u = edge(b, c, px, py) / area;
            let v = edge(c, a, px, py) / area;
            let w = 1.0 - u - v;
            if u >= -1e-9 && v >= -1e-9 && w >= -1e-9 {
                let depth = quantity.convert(u * at_a + v * at_b + w * at_c);
                values[pixel] = depth as f32;
            }
        }
    }
}

/// Returns the first and the last column that a triangle may cover in a row. The bounding boxes of long thin triangles, which
/// are common at outlines of large holes, would contain far more pixels.
fn row_of([a, b, c]: [Point; 3], y: usize) -> (usize, usize) {
    let (mut left, mut right) = (f64::INFINITY, f64::NEG_INFINITY);
    for (p, q) in [(a, b), (b, c), (c, a)] {
        if y < p.y.min(q.y) || y > p.y.max(q.y) {
            continue;
        }
        let (from, to) = (p.x as f64, q.x as f64);
        let ends = if p.y == q.y {
            [from, to]
        } else {
            let share = (y as f64 - p.y as f64) / (q.y as f64 - p.y as f64);
            [from + share * (to - from); 2]
        };
        left = ends.into_iter().fold(left, f64::min);
        right = ends.into_iter().fold(right, f64::max);
    }
    // Rounding must not drop a pixel on an edge.
    let farthest = a.x.max(b.x).max(c.x);
    (
        (left - 1e-6).ceil().max(0.0) as usize,
        ((right + 1e-6).floor() as usize).min(farthest),
    )
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
        let sparse = DepthMap::from_points(40, 30, &points);
        let dense = linear(&sparse, Quantity::Depth).unwrap();
        for y in 0..30 {
            for x in 0..40 {
                assert!((dense.at(x, y) - plane(x, y)).abs() < 1e-5, "{x} {y}");
            }
        }
    }

    /// The ray through pixel (x, y) is ((x - cx) / f, (y - cy) / f, 1). It intersects the plane n . p = d at the depth d / (n .
    /// ray).
    #[test]
    fn a_slanted_plane_seen_by_a_pinhole_camera_is_reproduced_by_inverse_depths() {
        let (focal, centre) = (50.0, (19.5, 14.5));
        let (normal, distance) = ([0.3, 0.8, 0.25], 1.6);
        let plane = |x: usize, y: usize| {
            let ray = [(x as f64 - centre.0) / focal, (y as f64 - centre.1) / focal];
            (distance / (normal[0] * ray[0] + normal[1] * ray[1] + normal[2])) as f32
        };
        // 1.6 / 0.599 and 1.6 / 0.085.
        assert!((plane(39, 29) - 2.671).abs() < 1e-3 && (plane(4, 10) - 18.824).abs() < 1e-3);
        let at = [(4, 10), (39, 10), (4, 29), (39, 29), (11, 17), (25, 20)];
        let points = at.map(|(x, y)| Point {
            x,
            y,
            depth: plane(x, y),
        });
        let sparse = DepthMap::from_points(40, 30, &points);
        let inverse = linear(&sparse, Quantity::Inverse).unwrap();
        let straight = linear(&sparse, Quantity::Depth).unwrap();
        let mut worst: f32 = 0.0;
        for y in 10..30 {
            for x in 4..40 {
                let truth = plane(x, y);
                assert!((inverse.at(x, y) / truth - 1.0).abs() < 1e-5, "{x} {y}");
                worst = worst.max((straight.at(x, y) / truth - 1.0).abs());
            }
        }
        assert!(worst > 0.1, "{worst}");
    }

    /// A map of 120x90 pixels with holes of many shapes, and single points in one of them.
    fn with_holes() -> DepthMap {
        let depth = |x: usize, y: usize| {
            let (u, v) = (x as f32, y as f32);
            let in_disc = (u - 40.0).hypot(v - 50.0) < 22.0;
            let in_shadow = (70..78).contains(&x) && y > 20 || x + 2 * y < 30 || x > 110;
            let alone = (x, y) == (42, 55) || (x, y) == (33, 41);
            let speckle = (x * 7 + y * 13).is_multiple_of(31);
            if (in_disc && !alone) || in_shadow || speckle {
                0.0
            } else {
                2.0 + 0.3 * (u / 9.0).sin() + 0.2 * (v / 5.0).cos() + (u * v % 7.0) * 0.01
            }
        };
        let values = (0..120 * 90).map(|i| depth(i % 120, i / 120)).collect();
        DepthMap::new(120, 90, values).unwrap()
    }

    #[test]
    fn measured_pixels_keep_their_depth() {
        let sparse = with_holes();
        for quantity in [Quantity::Depth, Quantity::Inverse] {
            let dense = linear(&sparse, quantity).unwrap();
            assert_eq!(dense.count(), dense.values().len());
            for p in sparse.points() {
                assert_eq!(dense.at(p.x, p.y), p.depth, "{p:?}");
            }
            // A map without holes is returned unchanged.
            let whole = DepthMap::new(3, 2, vec![1.7; 6]).unwrap();
            assert_eq!(linear(&whole, quantity).unwrap(), whole);
        }
    }

    /// For any selection of points, each pixel in a hole lies in a triangle whose circumcircle contains no measurement: the
    /// definition of the Delaunay triangulation.
    #[test]
    fn triangles_over_holes_are_those_of_all_points() {
        let sparse = with_holes();
        let points = edge_points(&sparse);
        assert!(4 * points.len() < 3 * sparse.count(), "{}", points.len());
        let all: Vec<Point> = sparse.points().collect();
        let mut covered = 0;
        for corners in triangles(&points) {
            let mut values = vec![f32::NAN; sparse.values().len()];
            fill(&mut values, &sparse, corners, Quantity::Depth);
            let inside = values.iter().filter(|value| !value.is_nan()).count();
            if inside == 0 {
                continue;
            }
            covered += inside;
            let [a, b, c] = corners.map(|p| [p.x as f64, p.y as f64]);
            for p in &all {
                let [[ax, ay], [bx, by], [cx, cy]] =
                    [a, b, c].map(|[x, y]| [x - p.x as f64, y - p.y as f64]);
                let squares = [ax * ax + ay * ay, bx * bx + by * by, cx * cx + cy * cy];
                let inside = ax * (by * squares[2] - squares[1] * cy)
                    - ay * (bx * squares[2] - squares[1] * cx)
                    + squares[0] * (bx * cy - by * cx);
                let turn = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
                assert!(inside * turn.signum() <= 0.0, "{p:?} in {corners:?}");
            }
        }
        assert!(covered > 1000, "{covered}");
    }

    #[test]
    fn rows_of_a_triangle_hold_all_pixels_of_its_box_that_it_covers() {
        let mut rng = lsdc_rng::Rng::stream(0, &["rows"]);
        let mut point = || Point {
            x: rng.below(40) as usize,
            y: rng.below(30) as usize,
            depth: 1.0 + rng.below(100) as f32,
        };
        let empty = DepthMap::empty(40, 30);
        for _ in 0..300 {
            let corners @ [a, b, c] = [point(), point(), point()];
            let mut values = vec![f32::NAN; 1200];
            fill(&mut values, &empty, corners, Quantity::Depth);
            let side = |p: Point, q: Point, x: i64, y: i64| {
                let [px, py, qx, qy] = [p.x, p.y, q.x, q.y].map(|v| v as i64);
                (qx - px) * (y - py) - (qy - py) * (x - px)
            };
            let area = side(a, b, c.x as i64, c.y as i64);
            for (i, value) in values.iter().enumerate() {
                let (x, y) = (i as i64 % 40, i as i64 / 40);
                let sides = [side(a, b, x, y), side(b, c, x, y), side(c, a, x, y)];
                let inside = area != 0 && sides.iter().all(|side| side * area.signum() >= 0);
                assert_eq!(!value.is_nan(), inside, "{corners:?} {x} {y}");
            }
        }
    }
}
