//! Surface normals of a depth map.

use lsdc_core::DepthMap;

/// Tolerance for inverse depths of one surface: the slopes on both sides of a pixel differ by less than this share of their
/// value per pixel.
const SAME_SURFACE: f64 = 0.01;

/// Returns the unit normals of a depth map seen by a pinhole camera `[fx, fy, cx, cy]`, in camera coordinates (x to the
/// right, y down, z forwards), facing the camera; row by row, `None` for pixels without depth, or without a neighbour with
/// depth in the row or in the column.
///
/// On the plane n·X = d, inverse depth is n·(x, y, 1) / d: linear in the image coordinates x, y in focal lengths. Hence its
/// slopes a and b and its value w give the normal (a, b, w - a x - b y), which is exact on planes. At a depth edge, the
/// slope towards the more similar neighbour is used.
pub(super) fn normals(depth: &DepthMap, [fx, fy, cx, cy]: [f64; 4]) -> Vec<Option<[f64; 3]>> {
    let (width, height) = (depth.width(), depth.height());
    let inverse = |x: usize, y: usize| {
        let found = depth.get(x, y);
        found.filter(|z| *z > 0.0).map(|z| f64::from(z).recip())
    };
    let normal = |x: usize, y: usize| {
        let own = inverse(x, y)?;
        let before = |from: usize| from.checked_sub(1);
        let across = slope(
            own,
            before(x).and_then(|x| inverse(x, y)),
            inverse(x + 1, y),
        )?;
        let down = slope(
            own,
            before(y).and_then(|y| inverse(x, y)),
            inverse(x, y + 1),
        )?;
        let (a, b) = (across * fx, down * fy);
        let [u, v] = [(x as f64 - cx) / fx, (y as f64 - cy) / fy];
        // This vector has a positive dot product with the ray (u, v, 1): its negative faces the camera.
        let away = [a, b, own - a * u - b * v];
        let length = away.iter().map(|v| v * v).sum::<f64>().sqrt();
        (length.is_normal()).then(|| away.map(|v| -v / length))
    };
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    pixels.map(|(x, y)| normal(x, y)).collect()
}

/// Returns the slope of inverse depth per pixel.
fn slope(own: f64, before: Option<f64>, after: Option<f64>) -> Option<f64> {
    let (before, after) = (before.map(|v| own - v), after.map(|v| v - own));
    match (before, after) {
        (Some(a), Some(b)) if (a - b).abs() <= SAME_SURFACE * own => Some(f64::midpoint(a, b)),
        (Some(a), Some(b)) if a.abs() > b.abs() => Some(b),
        (one, other) => one.or(other),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (usize, usize) = (40, 30);
    const CAMERA: [f64; 4] = [50.0, 60.0, 18.0, 16.0];

    /// The depths of the plane n·X = d.
    fn plane([x, y, z]: [f64; 3], d: f64) -> impl Fn(usize, usize) -> f64 {
        let [fx, fy, cx, cy] = CAMERA;
        move |u, v| d / (x * (u as f64 - cx) / fx + y * (v as f64 - cy) / fy + z)
    }

    fn map(depth: impl Fn(usize, usize) -> f64) -> DepthMap {
        let (width, height) = SIZE;
        let value = |i: usize| depth(i % width, i / width) as f32;
        DepthMap::new(width, height, (0..width * height).map(value).collect()).unwrap()
    }

    fn angle(a: [f64; 3], b: [f64; 3]) -> f64 {
        let dot: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
        dot.min(1.0).acos().to_degrees()
    }

    /// The expected normal is the negative of n, so that it faces the camera.
    #[test]
    fn planes_have_their_normals_at_every_pixel() {
        for (n, d) in [
            ([0.0, 0.0, 1.0], 2.0),
            ([0.6, 0.0, 0.8], 3.0),
            ([0.0, -0.8, 0.6], 5.0),
            ([0.36, 0.48, 0.8], 0.1),
        ] {
            let found = normals(&map(plane(n, d)), CAMERA);
            for normal in found {
                let error = angle(normal.unwrap(), n.map(|v| -v));
                assert!(error < 0.01, "{n:?}: {error}");
            }
        }
    }

    #[test]
    fn a_depth_edge_bends_no_normal() {
        let (near, far) = (plane([0.6, 0.0, 0.8], 1.0), plane([0.0, 0.6, 0.8], 4.0));
        let edge = |x: usize| x < 20;
        let found = normals(
            &map(|x, y| if edge(x) { near(x, y) } else { far(x, y) }),
            CAMERA,
        );
        for (i, normal) in found.into_iter().enumerate() {
            let n = if edge(i % SIZE.0) {
                [-0.6, 0.0, -0.8]
            } else {
                [0.0, -0.6, -0.8]
            };
            assert!(angle(normal.unwrap(), n) < 0.01, "{i}");
        }
    }

    #[test]
    fn pixels_without_neighbours_have_none() {
        let found = normals(&map(|x, y| f64::from((x, y) == (7, 9))), CAMERA);
        assert!(found.iter().all(Option::is_none));
        // A single row has no vertical slope.
        let found = normals(&map(|_, y| f64::from(y == 9)), CAMERA);
        assert!(found.iter().all(Option::is_none));
    }
}
