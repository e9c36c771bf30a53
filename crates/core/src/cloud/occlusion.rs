//! Removal of occluded points that show between the nearer points of a closed surface.

use super::surface::NEARER;
use rayon::prelude::*;
use std::f64::consts::TAU;

/// A point is surrounded by nearer ones if the largest angle between two directions to them, as seen from it, is
/// below this.
const SURROUNDED: f64 = 140.0 / 360.0 * TAU;
/// Inside the outline of an object that angle is at most a half turn. Between the outermost points of an object and
/// its outline, and as far outside, nothing distinguishes an occluded point from one that is seen. Where any are
/// occluded, one too many harms a map more than one too few. Where no point lies in the open direction, it is not
/// known what surface ends there.
const OPEN: f64 = 250.0 / 360.0 * TAU;
const OPEN_TO_NOTHING: f64 = 0.5 * TAU;
/// The share of these that must be surrounded. It is about a half in a cloud of a scanner beside the camera and a
/// tenth, at inner edges, where the camera has seen all points.
const SHARE: f64 = 0.3;
/// Fewer nearer points are no surface.
const FEWEST: usize = 3;
/// The radius of the window, in mean distances between points, and its bounds in pixels: where points are farther
/// apart, the space between them may really be open.
const REACH: f64 = 2.5;
const BOUNDS: (f64, f64) = (1.5, 12.0);

/// Removes occluded points and returns their number. A point is occluded if nearer points surround it (after
/// Pintus, Gobbetti and Agus 2011, "Real-time rendering of massive unstructured raw point clouds using
/// screen-space operators"), unless they lie on a slope with it.
pub(super) fn remove_hidden(width: usize, depths: &mut [f32]) -> usize {
    let window = Neighbourhood::new(reach(width, depths));
    let visible: &[f32] = depths;
    let found = (0..depths.len()).into_par_iter().filter_map(|i| {
        let enclosed = window.enclosed(visible, width, i);
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

/// The radius of the window, from the density of the points in the areas that have any.
fn reach(width: usize, depths: &[f32]) -> f64 {
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
    (REACH * distance).clamp(BOUNDS.0, BOUNDS.1)
}

/// The pixels around one.
struct Neighbourhood(Vec<Offset>);

/// A pixel, as seen from another.
struct Offset {
    right: isize,
    down: isize,
    distance: f64,
    direction: f64,
}

/// A point in the window.
struct Other<'a> {
    place: &'a Offset,
    /// How much larger its inverse depth is, a pixel; on a plane, that of the opposite direction is as much
    /// smaller.
    slope: f64,
}

impl Neighbourhood {
    fn new(reach: f64) -> Self {
        let most = reach as isize;
        let row = |down: isize| (-most..=most).map(move |right| (right, down));
        let places = (-most..=most).flat_map(row).map(|(right, down)| Offset {
            right,
            down,
            distance: (right as f64).hypot(down as f64),
            direction: (down as f64).atan2(right as f64),
        });
        let inside = |place: &Offset| place.distance > 0.0 && place.distance <= reach;
        Self(places.filter(inside).collect())
    }

    /// Whether nearer points surround a point, if it lies between them or next to their outline.
    fn enclosed(&self, depths: &[f32], width: usize, pixel: usize) -> Option<bool> {
        /// Off the middle of the widest opening.
        const AHEAD: f64 = TAU / 6.0;
        let depth = depths[pixel];
        if depth <= 0.0 {
            return None;
        }
        let (x, y) = ((pixel % width) as isize, (pixel / width) as isize);
        let (mut nearer, mut farther, mut beyond) = (Vec::new(), Vec::new(), Vec::new());
        for place in &self.0 {
            let (column, row) = (x + place.right, y + place.down);
            if !(0..width as isize).contains(&column) || row < 0 {
                continue;
            }
            let other = depths.get(row as usize * width + column as usize);
            let Some(&other) = other.filter(|other| **other > 0.0) else {
                continue;
            };
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
}

impl Other<'_> {
    /// Whether a farther point on the other side lies on a slope with this one.
    fn continues(&self, far: &Self) -> bool {
        /// Radians off the opposite direction.
        const ASIDE: f64 = TAU / 12.0;
        /// Of the slope towards the nearer point.
        const LEAST: f64 = 0.5;
        let turn = turn(self.place.direction, far.place.direction);
        turn > 0.5 * TAU - ASIDE && -far.slope > LEAST * self.slope
    }
}

/// The angle between two directions, up to a half turn.
fn turn(a: f64, b: f64) -> f64 {
    let turn = (a - b).rem_euclid(TAU);
    turn.min(TAU - turn)
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
                // Next to the box's edge either is right.
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
