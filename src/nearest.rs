//! The nearest of scattered places on a grid of pixels.

/// Places in square cells.
#[derive(Clone, Debug)]
pub struct Cells {
    places: Vec<[usize; 2]>,
    members: Vec<Vec<usize>>,
    side: usize,
    columns: usize,
    rows: usize,
}

impl Cells {
    /// Sorts `places` (x, y) into cells, about one to each.
    pub fn new(places: &[[usize; 2]]) -> Self {
        let extent = |axis: usize| places.iter().map(|p| p[axis] + 1).max().unwrap_or(1);
        let (width, height) = (extent(0), extent(1));
        let area = width * height;
        let side = ((area as f64 / places.len().max(1) as f64).sqrt() as usize).max(1);
        let (columns, rows) = (width.div_ceil(side), height.div_ceil(side));
        let mut members = vec![Vec::new(); columns * rows];
        for (i, [x, y]) in places.iter().enumerate() {
            members[y / side * columns + x / side].push(i);
        }
        Self {
            places: places.to_owned(),
            members,
            side,
            columns,
            rows,
        }
    }

    /// The `count` nearest places to a pixel (x, y), the nearest first: squared distance and index;
    /// the first in order among equals.
    pub fn nearest(&self, [x, y]: [usize; 2], count: usize) -> Vec<(usize, usize)> {
        let (column, row) = (x / self.side, y / self.side);
        let mut found: Vec<(usize, usize)> = Vec::with_capacity(4 * count);
        // Beyond the last place there are rings that hold none.
        let rings = (column + self.columns).max(row + self.rows);
        for ring in 0..rings {
            // Every place of this ring is at least so far away.
            let closest = (ring.saturating_sub(1) * self.side).pow(2);
            if found.len() >= count {
                found.sort_unstable();
                if found[count - 1].0 < closest {
                    break;
                }
            }
            self.ring(column, row, ring, |i| {
                let p = &self.places[i];
                found.push((p[0].abs_diff(x).pow(2) + p[1].abs_diff(y).pow(2), i));
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
                    self.members[r * self.columns + c]
                        .iter()
                        .for_each(|&i| visit(i));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Rng;

    #[test]
    fn the_nearest_places_are_found() {
        let mut rng = Rng::stream(1, &["nearest"]);
        let places: Vec<[usize; 2]> = (0..20)
            .map(|_| [rng.below(60) as usize, rng.below(40) as usize])
            .collect();
        let cells = Cells::new(&places);
        // Pixels beyond the last place too.
        for y in 0..50 {
            for x in 0..70 {
                let mut all: Vec<(usize, usize)> = places
                    .iter()
                    .enumerate()
                    .map(|(i, p)| (p[0].abs_diff(x).pow(2) + p[1].abs_diff(y).pow(2), i))
                    .collect();
                all.sort_unstable();
                assert_eq!(cells.nearest([x, y], 5), all[..5]);
            }
        }
    }
}
