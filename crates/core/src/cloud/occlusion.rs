//! Removal of occluded points that are visible through gaps between the nearer points of a closed surface.

use super::surface::NEARER;
use super::window::{Offset, Window};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// A point is surrounded by nearer points if the largest angle between neighbouring directions to them, as seen from it, is
/// below this.
const SURROUNDED: f64 = 140.0 / 360.0 * TAU;
/// Inside the outline of an object this angle is at most a half turn. Between the outermost points of an object and its
/// outline, and equally far outside, occluded and visible points cannot be distinguished. If any points are occluded, one point
/// too many harms a map more than one too few. If there is no point in the open direction, the surface that ends there is
/// unknown.
const OPEN: f64 = 250.0 / 360.0 * TAU;
const OPEN_TO_NOTHING: f64 = 0.5 * TAU;
/// Least share of surrounded points among the enclosed ones for which all of them are removed. It is about a half in a cloud of
/// a scanner next to the camera and a tenth, at inner edges, in a cloud whose points are all visible to the camera.
const SHARE: f64 = 0.3;
/// Least number of nearer points that form a surface.
const FEWEST: usize = 3;
/// Radius of the window, in mean distances between points, and its bounds in pixels: gaps between points that are farther apart
/// may be real.
const REACH: f64 = 2.5;
const BOUNDS: (f64, f64) = (1.5, 12.0);

/// Removes occluded points and returns their number. A point is occluded if nearer points surround it (after
/// Pintus, Gobbetti and Agus 2011, "Real-time rendering of massive unstructured raw point clouds using
/// screen-space operators"), unless they lie on a slope with it.
pub(super) fn remove_hidden(width: usize, depths: &mut [f32]) -> usize {
    let window = Window::new([reach(width, depths); 2]);
    let visible: &[f32] = depths;
    let found = (0..depths.len()).into_par_iter().filter_map(|i| {
        let enclosed = enclosed(&window, visible, width, i);
        enclosed.map(|surrounded| (i, surrounded))
    });
    let mut hidden: Vec<(usize, bool)> = found.collect();
    let surrounded = hidden.iter().filter(|(_, surrounded)| *surrounded).count();
    if (surrounded as f64) < SHARE * hidden.len() as f64 {
        hidden.retain(|(_, surrounded)| *surrounded);
    }
    for &(i, _) in &hidden {
        depths[i] = 0.0;
    }
    hidden.len()
}

/// Returns the radius of the window, from the density of the points in non-empty areas.
fn reach(width: usize, depths: &[f32]) -> f64 {
    /// Side in pixels of the cells for the measurement of the covered area.
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
    (REACH * distance).clamp(BOUNDS.0, BOUNDS.1)
}

/// A point in the window.
struct Other<'a> {
    place: &'a Offset,
    /// Increase of inverse depth per pixel towards this point; on a plane, the increase in the opposite direction is the
    /// negative of this.
    slope: f64,
}

/// Whether nearer points surround a point; `None` if it is neither between them nor next to their outline.
fn enclosed(window: &Window, depths: &[f32], width: usize, pixel: usize) -> Option<bool> {
    /// Tolerance around the middle of the widest opening.
    const AHEAD: f64 = TAU / 6.0;
    let depth = depths[pixel];
    if depth <= 0.0 {
        return None;
    }
    let (mut nearer, mut farther, mut beyond) = (Vec::new(), Vec::new(), Vec::new());
    for (place, other) in window.points(depths, width, pixel) {
        let rise = f64::from(other).recip() - f64::from(depth).recip();
        let slope = rise / place.distance;
        if other < depth * (1.0 - NEARER) {
            nearer.push(Other { place, slope });
            continue;
        }
        beyond.push(place.direction);
        if other > depth {
            farther.push(Other { place, slope });
        }
    }
    nearer.retain(|near| !farther.iter().any(|far| near.continues(far)));
    let mut directions: Vec<f64> = nearer.iter().map(|near| near.place.direction).collect();
    directions.sort_by(f64::total_cmp);
    let (&first, &last) = (directions.first()?, directions.last()?);
    let gaps = directions.array_windows().map(|&[a, b]| (b - a, a));
    let (open, from) = gaps.fold((first + TAU - last, last), |widest, gap| {
        if gap.0 > widest.0 { gap } else { widest }
    });
    let is_ahead = |direction: &f64| turn(*direction, from + 0.5 * open) < AHEAD;
    let most = if beyond.iter().any(is_ahead) {
        OPEN
    } else {
        OPEN_TO_NOTHING
    };
    (directions.len() >= FEWEST && open < most).then_some(open < SURROUNDED)
}

impl Other<'_> {
    /// Whether a farther point on the opposite side is on the same slope as this one.
    fn continues(&self, far: &Self) -> bool {
        /// Tolerance in radians from the opposite direction.
        const ASIDE: f64 = TAU / 12.0;
        /// Least slope, as a share of the slope towards the nearer point.
        const LEAST: f64 = 0.5;
        let turn = turn(self.place.direction, far.place.direction);
        turn > 0.5 * TAU - ASIDE && -far.slope > LEAST * self.slope
    }
}

/// Returns the angle between two directions, up to a half turn.
fn turn(a: f64, b: f64) -> f64 {
    let turn = (a - b).rem_euclid(TAU);
    turn.min(TAU - turn)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A box at 2 m in front of a wall at 5 m, both measured at every `step`th pixel, the wall also between the points of the
    /// box.
    #[test]
    fn a_wall_is_not_seen_through_a_box() {
        const SIZE: usize = 120;
        let within = |x: usize, y: usize, margin: usize| {
            (30 + margin..90 - margin).contains(&x) && (40 + margin..80 - margin).contains(&y)
        };
        let beside = |x: usize, y: usize, margin: usize| {
            (30 - margin..90 + margin).contains(&x) && (40 - margin..80 + margin).contains(&y)
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
                // Next to the edge of the box, either result is right.
                if *before == 5.0 && within(x, y, step + 2) {
                    assert_eq!(*after, 0.0, "{step}: through the box at {x}, {y}");
                } else if !beside(x, y, step + step / 2) || *before == 2.0 {
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
