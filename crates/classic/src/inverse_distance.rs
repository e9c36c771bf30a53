//! Inverse-distance weighting (Shepard 1968).

use super::neighbours::{Neighbours, each_pixel};
use crate::error::Result;
use lsdc_core::DepthMap;

/// Number of nearest points used for a pixel.
const NEAREST: usize = 8;

pub(super) fn inverse_distance(sparse: &DepthMap) -> Result<DepthMap> {
    let neighbours = Neighbours::new(sparse);
    each_pixel(sparse, |x, y| {
        let nearest = neighbours.nearest(x, y, NEAREST);
        let depth = |i: usize| neighbours.points[i].depth;
        if nearest[0].0 == 0.0 {
            return depth(nearest[0].1);
        }
        let (mut sum, mut weights) = (0.0, 0.0);
        for (square, i) in nearest {
            let weight = 1.0 / square;
            sum += weight * f64::from(depth(i));
            weights += weight;
        }
        (sum / weights) as f32
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsdc_core::Point;

    #[test]
    fn two_points_weigh_by_the_square_of_their_distance() {
        let point = |x, depth| Point { x, y: 0, depth };
        let sparse = DepthMap::from_points(4, 1, &[point(0, 1.0), point(3, 6.0)]);
        let dense = inverse_distance(&sparse).unwrap();
        // At distances 1 and 2 the weights are 4 : 1.
        assert!((dense.at(1, 0) - 2.0).abs() < 1e-6);
        assert_eq!((dense.at(0, 0), dense.at(3, 0)), (1.0, 6.0));
    }
}
