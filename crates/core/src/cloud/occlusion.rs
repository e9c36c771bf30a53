//! Removal of occluded points that show between the nearer points of a closed surface.

use super::surface::NEARER;
use rayon::prelude::*;

/// The number of sectors around a point, and in how many of them nearer points must lie for it to be
/// occluded. At a straight edge, they lie in half of the sectors.
const SECTORS: usize = 8;
const HIDING: u32 = 6;
/// Half the side of the window, in mean distances between points, and its bounds in pixels: where points are
/// farther apart, the space between them may really be open.
const REACH: f64 = 3.0;
const BOUNDS: (usize, usize) = (1, 12);

/// Removes occluded points and returns their number. A point is occluded if nearer points surround it (after
/// Pintus, Gobbetti and Agus 2011, "Real-time rendering of massive unstructured raw point clouds using
/// screen-space operators", but counting sectors instead of measuring angles).
pub(super) fn remove_hidden(width: usize, depths: &mut [f32]) -> usize {
    let height = depths.len() / width.max(1);
    let reach = reach(width, depths);
    let directions = Directions::new(reach);
    let seen: &[f32] = depths;
    let hidden: Vec<usize> = (0..depths.len())
        .into_par_iter()
        .filter(|&i| {
            let depth = seen[i];
            if depth == 0.0 {
                return false;
            }
            let (x, y) = (i % width, i / width);
            let (left, right) = (x.saturating_sub(reach), (x + reach).min(width - 1));
            let mut sectors = 0_u8;
            for row in y.saturating_sub(reach)..=(y + reach).min(height - 1) {
                for column in left..=right {
                    let other = seen[row * width + column];
                    if other > 0.0 && other < depth * (1.0 - NEARER) {
                        sectors |= 1 << directions.sector(column + reach - x, row + reach - y);
                    }
                }
            }
            sectors.count_ones() >= HIDING
        })
        .collect();
    for &i in &hidden {
        depths[i] = 0.0;
    }
    hidden.len()
}

/// Half the side of the window, from the density of the points in the areas that have any.
fn reach(width: usize, depths: &[f32]) -> usize {
    /// Cells of that many pixels a side are covered or not.
    const CELL: usize = 16;
    let across = width.div_ceil(CELL);
    let mut covered = vec![false; across * (depths.len() / width.max(1)).div_ceil(CELL)];
    let mut points = 0_usize;
    for (i, &depth) in depths.iter().enumerate() {
        if depth > 0.0 {
            points += 1;
            covered[i / width / CELL * across + i % width / CELL] = true;
        }
    }
    let area = covered.iter().filter(|&&c| c).count() * CELL * CELL;
    let distance = (area as f64 / points.max(1) as f64).sqrt();
    ((REACH * distance).round() as usize).clamp(BOUNDS.0, BOUNDS.1)
}

/// The sector of each position in the window.
struct Directions {
    side: usize,
    sectors: Vec<u8>,
}

impl Directions {
    fn new(reach: usize) -> Self {
        let side = 2 * reach + 1;
        let sector = |i: usize| {
            let x = (i % side) as f64 - reach as f64;
            let y = (i / side) as f64 - reach as f64;
            let turn = y.atan2(x) / std::f64::consts::TAU + 0.5;
            ((turn * SECTORS as f64) as usize % SECTORS) as u8
        };
        Self {
            side,
            sectors: (0..side * side).map(sector).collect(),
        }
    }

    fn sector(&self, column: usize, row: usize) -> u8 {
        self.sectors[row * self.side + column]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A box at 2 m in front of a wall at 5 m, both seen at every `step`th pixel, the wall between
    /// the points of the box too.
    #[test]
    fn a_wall_is_not_seen_through_a_box() {
        const SIZE: usize = 120;
        let within = |x: usize, y: usize, margin: usize| {
            (30 + margin..90 - margin).contains(&x) && (40 + margin..80 - margin).contains(&y)
        };
        for step in [2, 5, 8] {
            let mut depths = vec![0.0; SIZE * SIZE];
            for y in (0..SIZE).step_by(step) {
                for x in (0..SIZE).step_by(step) {
                    depths[y * SIZE + x] = 5.0;
                    if within(x, y, 0) {
                        depths[y * SIZE + x] = 2.0;
                        depths[(y + step / 2) * SIZE + x + 1] = 5.0;
                    }
                }
            }
            let before = depths.clone();
            remove_hidden(SIZE, &mut depths);
            for (i, (before, after)) in before.iter().zip(&depths).enumerate() {
                let (x, y) = (i % SIZE, i / SIZE);
                // In a ring about the box's edge either is right.
                if *before == 5.0 && within(x, y, step + 2) {
                    assert_eq!(*after, 0.0, "{step}: through the box at {x}, {y}");
                } else if !within(x, y, 0) || *before == 2.0 {
                    assert_eq!(before, after, "{step}: {x}, {y}");
                }
            }
        }
    }

    #[test]
    fn a_slanted_floor_hides_nothing() {
        const SIZE: usize = 60;
        let mut depths: Vec<f32> = (0..SIZE * SIZE)
            .map(|i| 200.0 / (1 + i / SIZE) as f32)
            .collect();
        assert_eq!(remove_hidden(SIZE, &mut depths), 0);
    }

    #[test]
    fn nothing_is_hidden_by_nothing() {
        assert_eq!(remove_hidden(7, &mut [0.0; 21]), 0);
        assert_eq!(remove_hidden(1, &mut [1.0]), 0);
        assert_eq!(remove_hidden(3, &mut []), 0);
    }
}
