//! Selection of the points within a pixel that belong to its nearest surface.

use crate::observations::Observation;

/// Least difference, as a share of the depth, at which a nearer surface occludes a point.
pub(super) const NEARER: f32 = 0.05;

/// Least difference of two depths, in standard deviations, at which they belong to two surfaces.
const SURE: f32 = 3.0;

/// The depth up to which the nearest surface of each pixel extends, infinite without a point. A point with a large standard
/// deviation has less influence on the surface.
pub fn fronts<'a>(
    points: impl Iterator<Item = (usize, &'a Observation)>,
    pixels: usize,
) -> Vec<f32> {
    let mut fronts = vec![f32::INFINITY; pixels];
    for (pixel, point) in points {
        let reach = point.depth + SURE * point.sigma.unwrap_or(0.0);
        fronts[pixel] = fronts[pixel].min(reach);
    }
    fronts
}

/// Whether a point lies behind the surface in front of it, across a gap, rather than on it.
pub fn is_behind(point: &Observation, front: f32) -> bool {
    point.depth * (1.0 - NEARER) - SURE * point.sigma.unwrap_or(0.0) > front
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns whether each of the points, in one pixel, is hidden.
    fn hidden(points: &[(f32, Option<f32>)]) -> Vec<bool> {
        let points: Vec<Observation> = points
            .iter()
            .map(|&(depth, sigma)| Observation {
                u: 0.0,
                v: 0.0,
                depth,
                sigma,
            })
            .collect();
        let front = fronts(points.iter().map(|point| (0, point)), 1)[0];
        points.iter().map(|point| is_behind(point, front)).collect()
    }

    #[test]
    fn only_a_gap_hides() {
        let plane = [(2.0, None), (2.05, None), (1.98, None)];
        assert_eq!(hidden(&plane), [false; 3]);
        let behind = [(4.0, None), (2.0, None), (2.02, None)];
        assert_eq!(hidden(&behind), [true, false, false]);
    }

    #[test]
    fn a_near_point_of_unknown_depth_hides_nothing() {
        let vague = [(1.0, Some(5.0)), (3.0, Some(0.01))];
        assert_eq!(hidden(&vague), [false; 2]);
        let sure = [(1.0, Some(0.05)), (3.0, Some(0.01))];
        assert_eq!(hidden(&sure), [false, true]);
    }
}
