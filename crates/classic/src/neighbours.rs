//! Nearest-point search in a map.

use crate::error::Result;
use lsdc_core::nearest::NeighbourGrid;
use lsdc_core::{DepthMap, Point};
use rayon::prelude::*;

/// The points of a map, for nearest-point search.
pub(super) struct Neighbours {
    pub(super) points: Vec<Point>,
    cells: NeighbourGrid,
}

impl Neighbours {
    pub(super) fn new(sparse: &DepthMap) -> Self {
        Self::of(sparse.points().collect())
    }

    /// From some of the points of a map.
    pub(super) fn of(points: Vec<Point>) -> Self {
        let places: Vec<[f64; 2]> = points.iter().map(|p| [p.x as f64, p.y as f64]).collect();
        Self {
            points,
            cells: NeighbourGrid::new(&places),
        }
    }

    /// As [`NeighbourGrid::nearest`].
    pub(super) fn nearest(&self, x: usize, y: usize, count: usize) -> Vec<(f64, usize)> {
        self.cells.nearest([x as f64, y as f64], count)
    }

    /// Returns the depth of the nearest point.
    pub(super) fn nearest_depth(&self, x: usize, y: usize) -> f32 {
        let (_, i) = self.nearest(x, y, 1)[0];
        self.points[i].depth
    }
}

/// Computes every pixel of a map of the size of `sparse`, row by row in parallel.
pub(super) fn each_pixel(
    sparse: &DepthMap,
    value: impl Fn(usize, usize) -> f32 + Sync,
) -> Result<DepthMap> {
    let (width, height) = (sparse.width(), sparse.height());
    let mut values = vec![0.0; width * height];
    let rows = values.par_chunks_mut(width).enumerate();
    rows.for_each(|(y, row)| {
        let pixels = row.iter_mut().enumerate();
        pixels.for_each(|(x, pixel)| *pixel = value(x, y));
    });
    Ok(DepthMap::new(width, height, values)?)
}

/// Fills each pixel with the depth of the nearest point.
pub(super) fn nearest(sparse: &DepthMap) -> Result<DepthMap> {
    let neighbours = Neighbours::new(sparse);
    each_pixel(sparse, |x, y| neighbours.nearest_depth(x, y))
}
