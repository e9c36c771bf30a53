//! Points in square cells, for the nearest ones of a pixel.

use crate::data::{DepthMap, Point};
use crate::error::Result;
use rayon::prelude::*;

/// The points of a map, by place.
pub(super) struct Neighbours {
    pub(super) points: Vec<Point>,
    cells: Vec<Vec<usize>>,
    side: usize,
    columns: usize,
    rows: usize,
}

impl Neighbours {
    pub(super) fn new(sparse: &DepthMap) -> Self {
        let points: Vec<Point> = sparse.points().collect();
        let area = sparse.width() * sparse.height();
        let side = ((area as f64 / points.len().max(1) as f64).sqrt() as usize).max(1);
        let (columns, rows) = (
            sparse.width().div_ceil(side),
            sparse.height().div_ceil(side),
        );
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

    /// The `count` nearest points to a pixel, the nearest first: squared distance and index; the
    /// first in row order among equals.
    pub(super) fn nearest(&self, x: usize, y: usize, count: usize) -> Vec<(usize, usize)> {
        let (column, row) = (x / self.side, y / self.side);
        let mut found: Vec<(usize, usize)> = Vec::with_capacity(4 * count);
        for ring in 0..self.columns.max(self.rows) {
            // Every point of this ring is at least so far away.
            let closest = (ring.saturating_sub(1) * self.side).pow(2);
            if found.len() >= count {
                found.sort_unstable();
                if found[count - 1].0 < closest {
                    break;
                }
            }
            self.ring(column, row, ring, |i| {
                let p = &self.points[i];
                found.push((p.x.abs_diff(x).pow(2) + p.y.abs_diff(y).pow(2), i));
            });
        }
        found.sort_unstable();
        found.truncate(count);
        found
    }

    fn ring(&self, column: usize, row: usize, ring: usize, mut visit: impl FnMut(usize)) {
        for r in row.saturating_sub(ring)..(row + ring + 1).min(self.rows) {
            for c in column.saturating_sub(ring)..(column + ring + 1).min(self.columns) {
                if r.abs_diff(row).max(c.abs_diff(column)) == ring {
                    self.cells[r * self.columns + c]
                        .iter()
                        .for_each(|&i| visit(i));
                }
            }
        }
    }
}

/// Computes every pixel of a map as large as `sparse`, row by row in parallel.
pub(super) fn each_pixel(
    sparse: &DepthMap,
    value: impl Fn(usize, usize) -> f32 + Sync,
) -> Result<DepthMap> {
    let (width, height) = (sparse.width(), sparse.height());
    let mut values = vec![0.0; width * height];
    values
        .par_chunks_mut(width)
        .enumerate()
        .for_each(|(y, row)| {
            for (x, v) in row.iter_mut().enumerate() {
                *v = value(x, y);
            }
        });
    DepthMap::new(width, height, values)
}

/// The depth of the nearest point.
pub(super) fn nearest(sparse: &DepthMap) -> Result<DepthMap> {
    let neighbours = Neighbours::new(sparse);
    each_pixel(sparse, |x, y| {
        let (_, i) = neighbours.nearest(x, y, 1)[0];
        neighbours.points[i].depth
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Rng;

    #[test]
    fn the_nearest_points_are_found() {
        let mut rng = Rng::stream(1, &["nearest"]);
        let points: Vec<Point> = (0..20)
            .map(|i| Point {
                x: rng.below(60) as usize,
                y: rng.below(40) as usize,
                depth: 1.0 + i as f32,
            })
            .collect();
        let neighbours = Neighbours::new(&DepthMap::from_points(60, 40, &points));
        for y in 0..40 {
            for x in 0..60 {
                let mut all: Vec<(usize, usize)> = neighbours
                    .points
                    .iter()
                    .enumerate()
                    .map(|(i, p)| (p.x.abs_diff(x).pow(2) + p.y.abs_diff(y).pow(2), i))
                    .collect();
                all.sort_unstable();
                assert_eq!(neighbours.nearest(x, y, 5), all[..5]);
            }
        }
    }
}
