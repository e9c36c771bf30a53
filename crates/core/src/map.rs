//! Dense and sparse depth maps.

use crate::error::Result;
use crate::image::{check_length, check_size};

/// A map of depths in metres along the optical axis, row by row; 0 means no measurement.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthMap {
    width: usize,
    height: usize,
    values: Vec<f32>,
    ignored: usize,
}

/// A pixel with a depth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Column, from the left.
    pub x: usize,
    /// Row, from the top.
    pub y: usize,
    /// Metres, positive and finite.
    pub depth: f32,
}

impl DepthMap {
    /// Makes a map from `height` rows of `width` values; NaN, infinite and negative values become 0.
    ///
    /// # Errors
    /// The number of values is not `width * height`, or the map is empty.
    pub fn new(width: usize, height: usize, mut values: Vec<f32>) -> Result<Self> {
        check_length(width, height, values.len())?;
        let mut ignored = 0;
        for value in &mut values {
            if !(value.is_finite() && *value >= 0.0) {
                *value = 0.0;
                ignored += 1;
            }
        }
        Ok(Self {
            width,
            height,
            values,
            ignored,
        })
    }

    /// A map without measurements.
    pub fn empty(width: usize, height: usize) -> Self {
        assert!(check_size(width, height).is_ok(), "{width}x{height} pixels");
        Self {
            width,
            height,
            values: vec![0.0; width * height],
            ignored: 0,
        }
    }

    /// A map with only the given points; points outside it are skipped.
    pub fn from_points(width: usize, height: usize, points: &[Point]) -> Self {
        let mut map = Self::empty(width, height);
        for point in points {
            if point.x < width && point.y < height && point.depth.is_finite() && point.depth > 0.0 {
                map.values[point.y * width + point.x] = point.depth;
            } else {
                map.ignored += 1;
            }
        }
        map
    }

    /// Number of columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// All values, row by row.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// All values, row by row, without a copy.
    pub fn into_values(self) -> Vec<f32> {
        self.values
    }

    /// The depth at a pixel of the map; 0 = no measurement.
    ///
    /// # Panics
    /// If the pixel is outside the map.
    pub fn at(&self, x: usize, y: usize) -> f32 {
        assert!(x < self.width, "column {x} of {}", self.width);
        self.values[y * self.width + x]
    }

    /// The depth at a pixel of the map; `None` outside.
    pub fn get(&self, x: usize, y: usize) -> Option<f32> {
        (x < self.width && y < self.height).then(|| self.at(x, y))
    }

    /// The pixels with a measurement, row by row.
    pub fn points(&self) -> impl Iterator<Item = Point> + '_ {
        self.values
            .iter()
            .enumerate()
            .filter(|(_, depth)| **depth > 0.0)
            .map(|(i, &depth)| Point {
                x: i % self.width,
                y: i / self.width,
                depth,
            })
    }

    /// The number of pixels with a measurement.
    pub fn count(&self) -> usize {
        self.values.iter().filter(|v| **v > 0.0).count()
    }

    /// The number of NaN, infinite and negative values that were replaced by 0.
    pub fn ignored(&self) -> usize {
        self.ignored
    }

    /// The smallest and the largest measurement, or `None` if there is none.
    pub fn range(&self) -> Option<(f32, f32)> {
        self.points().fold(None, |range, p| match range {
            None => Some((p.depth, p.depth)),
            Some((low, high)) => Some((low.min(p.depth), high.max(p.depth))),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_positive_finite_values_are_measurements() {
        let map = DepthMap::new(3, 2, vec![1.0, f32::NAN, -1.0, f32::INFINITY, 0.0, 2.5]).unwrap();
        assert_eq!(map.values(), [1.0, 0.0, 0.0, 0.0, 0.0, 2.5]);
        assert_eq!(map.count(), 2);
        assert_eq!(map.ignored(), 3);
        assert_eq!(map.range(), Some((1.0, 2.5)));
        let last = map.points().last().unwrap();
        assert_eq!((last.x, last.y), (2, 1));
    }

    #[test]
    fn pixels_outside_have_no_depth() {
        let map = DepthMap::new(2, 2, vec![1.0, 2.0, 3.0, 4.0]).unwrap();
        assert_eq!(
            [map.get(1, 1), map.get(2, 0), map.get(0, 2)],
            [Some(4.0), None, None]
        );
        // Not the first pixel of the next row.
        assert!(std::panic::catch_unwind(|| map.at(2, 0)).is_err());
    }

    #[test]
    fn points_that_are_no_measurements_are_counted() {
        let at = |x, depth| Point { x, y: 0, depth };
        let points = [at(0, 1.5), at(1, f32::NAN), at(2, -1.0), at(3, 2.0)];
        let map = DepthMap::from_points(3, 1, &points);
        assert_eq!(map.values(), [1.5, 0.0, 0.0]);
        assert_eq!(map.ignored(), 3);
    }

    #[test]
    fn a_wrong_count_is_an_error() {
        assert!(DepthMap::new(2, 2, vec![1.0; 3]).is_err());
        assert!(DepthMap::new(0, 2, vec![]).is_err());
        // Overflows to 0.
        assert!(DepthMap::new(1 << 32, 1 << 32, vec![]).is_err());
    }
}
