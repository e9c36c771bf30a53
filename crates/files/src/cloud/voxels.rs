//! Downsampling of clouds: one point per voxel.

use crate::ColoredPoint;
use std::collections::HashMap;
use std::collections::hash_map::Entry;

/// Returns one point per occupied voxel of edge length `size`: the mean of positions, colours and standard deviations
/// (errors of neighbours are correlated, so that the mean is not more certain than they are). Voxels are in the order of
/// their first points. The grid has a corner at the origin.
pub(super) fn thinned(points: &[ColoredPoint], size: f64) -> Vec<ColoredPoint> {
    let mut cubes: Vec<Sum> = Vec::new();
    let mut known: HashMap<[i64; 3], usize> = HashMap::new();
    for point in points {
        let cube = point.position.map(|v| (v / size).floor() as i64);
        match known.entry(cube) {
            Entry::Occupied(number) => cubes[*number.get()].add(point),
            Entry::Vacant(number) => {
                number.insert(cubes.len());
                let mut sum = Sum::default();
                sum.add(point);
                cubes.push(sum);
            }
        }
    }
    cubes.iter().map(Sum::mean).collect()
}

/// Sums over the points of a voxel.
#[derive(Default)]
struct Sum {
    count: u32,
    position: [f64; 3],
    color: [u64; 3],
    /// Number of points with a standard deviation, and the sum of their standard deviations.
    sigma: (u32, f64),
}

impl Sum {
    fn add(&mut self, point: &ColoredPoint) {
        self.count += 1;
        for axis in 0..3 {
            self.position[axis] += point.position[axis];
            self.color[axis] += u64::from(point.color[axis]);
        }
        if let Some(sigma) = point.sigma {
            self.sigma.0 += 1;
            self.sigma.1 += f64::from(sigma);
        }
    }

    fn mean(&self) -> ColoredPoint {
        let count = u64::from(self.count);
        let (known, sigma) = self.sigma;
        ColoredPoint {
            position: self.position.map(|sum| sum / f64::from(self.count)),
            color: self.color.map(|sum| ((sum + count / 2) / count) as u8),
            sigma: (known > 0).then(|| (sigma / f64::from(known)) as f32),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_point_in_each_cube() {
        let point = |x: f64, red: u8, sigma: f32| ColoredPoint {
            position: [x, 0.25, 2.0],
            color: [red, 7, 0],
            sigma: Some(sigma),
        };
        let points = [
            point(0.5, 10, 0.1),
            point(1.25, 20, 0.2),
            point(-0.25, 30, 0.3),
            point(0.75, 13, 0.3),
        ];
        let found = thinned(&points, 1.0);
        assert_eq!(found[0], point(0.625, 12, 0.2));
        assert_eq!(found[1..], points[1..3]);
        // A voxel around all points, and voxels so small that each contains one point.
        assert_eq!(thinned(&points, 1e9).len(), 2);
        assert_eq!(thinned(&points, 1e-6), points);
        assert_eq!(thinned(&[], 1.0), []);
    }
}
