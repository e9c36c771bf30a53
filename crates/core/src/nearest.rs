//! Nearest-neighbour search among scattered positions.

/// Positions sorted into square cells.
#[derive(Clone, Debug)]
pub struct NeighbourGrid {
    places: Vec<[f64; 2]>,
    /// The positions of all cells, cell by cell, each in the given order.
    members: Vec<usize>,
    /// Start of each cell in `members`, followed by the end.
    starts: Vec<usize>,
    /// The corner of the first cell.
    origin: [f64; 2],
    side: f64,
    columns: usize,
    rows: usize,
}

impl NeighbourGrid {
    /// Sorts `places` (x, y), which must be finite, into cells of about one position each.
    pub fn new(places: &[[f64; 2]]) -> Self {
        let bound = |axis: usize, start: f64, pick: fn(f64, f64) -> f64| {
            places.iter().map(|p| p[axis]).fold(start, pick)
        };
        let low = [0, 1].map(|axis| bound(axis, f64::INFINITY, f64::min));
        let high = [0, 1].map(|axis| bound(axis, f64::NEG_INFINITY, f64::max));
        let extent = [0, 1].map(|axis| (high[axis] - low[axis]).max(0.0) + 1.0);
        let side = (extent[0] * extent[1] / places.len().max(1) as f64).sqrt();
        // No more cells along an axis than positions, because these may be collinear.
        let side = side.max(extent[0].max(extent[1]) / places.len().max(1) as f64);
        let [columns, rows] = extent.map(|length| (length / side).ceil().max(1.0) as usize);
        let mut cells = Self {
            places: places.to_owned(),
            members: vec![0; places.len()],
            starts: vec![0; columns * rows + 1],
            origin: if places.is_empty() { [0.0; 2] } else { low },
            side,
            columns,
            rows,
        };
        let own: Vec<usize> = places.iter().map(|&place| cells.index(place)).collect();
        for &cell in &own {
            cells.starts[cell + 1] += 1;
        }
        for cell in 0..columns * rows {
            cells.starts[cell + 1] += cells.starts[cell];
        }
        let mut next = cells.starts.clone();
        for (i, cell) in own.into_iter().enumerate() {
            cells.members[next[cell]] = i;
            next[cell] += 1;
        }
        cells
    }

    /// Returns the column and row of the cell that contains a position, or of the nearest cell.
    fn cell(&self, place: [f64; 2]) -> [i64; 2] {
        let counts = [self.columns, self.rows];
        [0, 1].map(|axis| {
            let cell = ((place[axis] - self.origin[axis]) / self.side).floor();
            cell.clamp(0.0, (counts[axis] - 1) as f64) as i64
        })
    }

    /// Returns the index of the cell that contains a position, or of the nearest cell.
    pub(crate) fn index(&self, place: [f64; 2]) -> usize {
        let [column, row] = self.cell(place);
        row as usize * self.columns + column as usize
    }

    /// Returns the centre of a cell.
    pub(crate) fn centre(&self, cell: usize) -> [f64; 2] {
        let place = [cell % self.columns, cell / self.columns];
        [0, 1].map(|axis| self.origin[axis] + (place[axis] as f64 + 0.5) * self.side)
    }

    /// The `count` positions nearest to a given one, nearest first, as squared distance and index; ties are
    /// broken by index.
    pub fn nearest(&self, place: [f64; 2], count: usize) -> Vec<(f64, usize)> {
        // In ascending order.
        let mut found: Vec<(f64, usize)> = Vec::with_capacity(count + 1);
        self.find(place, count, &mut found);
        found
    }

    /// Like [`Self::nearest`], with reusable memory.
    pub(crate) fn find(&self, place: [f64; 2], count: usize, found: &mut Vec<(f64, usize)>) {
        found.clear();
        let [column, row] = self.cell(place);
        let outside = self.outside(place);
        let rings = if count > 0 {
            self.columns.max(self.rows) as i64
        } else {
            0
        };
        for ring in 0..rings {
            // The cells are convex: a path into them is no shorter than the hypotenuse of the path to their nearest position
            // and the path from there.
            let within = (ring as f64 - 1.0).max(0.0) * self.side;
            if found.len() == count && found[count - 1].0 < outside + within * within {
                break;
            }
            self.ring([column, row], ring, |i| {
                let [x, y] = self.places[i];
                let square = (x - place[0]).powi(2) + (y - place[1]).powi(2);
                let is_nearer =
                    |other: &(f64, usize)| square.total_cmp(&other.0).then(i.cmp(&other.1)).is_lt();
                if found.len() < count || found.last().is_some_and(is_nearer) {
                    let rank = found.partition_point(|other| !is_nearer(other));
                    found.insert(rank, (square, i));
                    found.truncate(count);
                }
            });
        }
    }

    /// Returns the squared distance from a position to the nearest cell.
    fn outside(&self, place: [f64; 2]) -> f64 {
        let counts = [self.columns, self.rows];
        let off = [0, 1].map(|axis| {
            let end = self.origin[axis] + counts[axis] as f64 * self.side;
            place[axis] - place[axis].clamp(self.origin[axis], end)
        });
        off[0] * off[0] + off[1] * off[1]
    }

    /// Visits the positions in the cells on the outline of a square, without visiting the cells inside it.
    fn ring(&self, [column, row]: [i64; 2], ring: i64, mut visit: impl FnMut(usize)) {
        let within = |middle: i64, count: usize| {
            (middle - ring).max(0)..(middle + ring + 1).min(count as i64)
        };
        let columns = within(column, self.columns);
        for r in within(row, self.rows) {
            // The top and bottom rows visit all columns, the rows between them only two.
            let step = if (r - row).abs() == ring { 1 } else { 2 * ring };
            let first = if step == 1 {
                columns.start
            } else {
                column - ring
            };
            for c in (first..columns.end).step_by(step as usize) {
                if c < 0 {
                    continue;
                }
                let cell = r as usize * self.columns + c as usize;
                for &i in &self.members[self.starts[cell]..self.starts[cell + 1]] {
                    visit(i);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsdc_rng::Rng;

    fn agree(places: &[[f64; 2]], step: f64) {
        let cells = NeighbourGrid::new(places);
        // Also beyond the last position.
        for y in -3..50 {
            for x in -3..70 {
                let here = [f64::from(x) * step, f64::from(y) * step];
                let square = |p: &[f64; 2]| (p[0] - here[0]).powi(2) + (p[1] - here[1]).powi(2);
                let mut all: Vec<(f64, usize)> = places.iter().map(square).zip(0..).collect();
                all.sort_unstable_by(|a, b| a.partial_cmp(b).unwrap());
                let count = places.len().min(5);
                assert_eq!(cells.nearest(here, 5), all[..count]);
            }
        }
    }

    #[test]
    fn the_nearest_places_are_found() {
        let mut rng = Rng::stream(1, &["nearest"]);
        let mut place = || [60.0, 40.0].map(|most| f64::from(rng.below(most as u32)));
        agree(&(0..20).map(|_| place()).collect::<Vec<_>>(), 1.0);
        let mut place = || [60.0, 40.0].map(|most| most * f64::from(rng.unit()) - 0.5);
        agree(&(0..33).map(|_| place()).collect::<Vec<_>>(), 0.73);
        // In a small part of the searched area.
        let mut place = || [3.0, 2.0].map(|most| 40.0 + most * f64::from(rng.unit()));
        agree(&(0..50).map(|_| place()).collect::<Vec<_>>(), 5.0);
        // Collinear, coincident, a single one, none.
        agree(
            &(0..9)
                .map(|i| [f64::from(i) * 7.0, 3.0])
                .collect::<Vec<_>>(),
            1.0,
        );
        agree(&[[5.0, 5.0]; 8], 1.0);
        agree(&[[5.0, 5.0]], 1.0);
        agree(&[], 1.0);
    }
}
