//! Flying pixels: pixels of a depth map between the surfaces on both sides of a depth edge.

use crate::map::DepthMap;
use rayon::prelude::*;

/// Tangent of the least angle between the viewing ray and the normal at which a surface counts as grazing: 80 degrees.
const GRAZING: f64 = 5.67;
/// Distance from a pixel within which the surfaces on both sides of an edge are examined, in radians of the view, and its
/// minimum in pixels.
const REACH: f64 = 0.03;
const LEAST: usize = 8;
/// Fraction of that distance, at its end, over which the slope of a surface is measured: one in this many.
const SURFACE: usize = 4;
/// Inverse depth has a constant slope on a plane. At a depth edge, the slopes on both surfaces are below this share of the
/// slope between them.
const FLAT: f64 = 0.7;
/// Least share of the difference between both neighbours at which a pixel is between them; otherwise it is the last pixel of a
/// surface.
const BETWEEN: f64 = 0.1;
/// Rows, columns and diagonals, as steps to the right and down.
const DIRECTIONS: [(isize, isize); 4] = [(1, 0), (0, 1), (1, 1), (1, -1)];

/// Returns for every pixel of a map, row by row, whether it is a flying pixel: a pixel that belongs to neither surface at a
/// depth edge, but to a ramp between both. `focal` are the focal lengths in pixels of the map.
///
/// A pixel is a flying pixel if, along a row, a column or a diagonal:
/// - the surface is seen at a grazing angle: between the two neighbours, depth changes by more than tan 80° of itself per
///   radian of the view, and its own inverse depth is between theirs, at least a tenth of the difference from either; and
/// - the surface is not a plane seen from the side, which would continue: within 0.03 radians of the view on both sides (16
///   pixels at a focal length of 525, and at least 8), inverse depth, which is linear on planes, changes less than 0.7 times as
///   fast.
///
/// Pixels without depth are never flying pixels, and end a surface like the border of the map.
pub fn flying_pixels(depth: &DepthMap, focal: [f64; 2]) -> Vec<bool> {
    let map = Inverse { depth };
    let lines = DIRECTIONS.map(|direction| Line::new(direction, focal));
    let rows = (0..depth.height()).into_par_iter();
    let row = |y: usize| {
        let flies = move |x: usize| lines.iter().any(|line| map.is_ramp([x, y], *line));
        (0..depth.width()).map(flies)
    };
    rows.flat_map_iter(row).collect()
}

/// A direction of the image.
#[derive(Clone, Copy)]
struct Line {
    step: (isize, isize),
    /// Angle in radians between neighbouring pixels.
    angle: f64,
    /// Distance in pixels up to which surfaces are examined.
    reach: usize,
}

impl Line {
    fn new((right, down): (isize, isize), [fx, fy]: [f64; 2]) -> Self {
        let angle = (right as f64 / fx).hypot(down as f64 / fy);
        Self {
            step: (right, down),
            angle,
            reach: ((REACH / angle).round() as usize).max(LEAST),
        }
    }
}

/// Access to a depth map as inverse depths.
#[derive(Clone, Copy)]
struct Inverse<'a> {
    depth: &'a DepthMap,
}

impl Inverse<'_> {
    /// Whether a pixel is on a ramp along a line.
    fn is_ramp(self, pixel: [usize; 2], line: Line) -> bool {
        let at = |steps| self.at(pixel, line.step, steps);
        let (Some(own), Some(before), Some(after)) = (at(0), at(-1), at(1)) else {
            return false;
        };
        let slope = 0.5 * (after - before).abs();
        let share = (own - before) / (after - before);
        let is_flat = |side| self.surface(pixel, line, side) < FLAT * slope;
        slope > GRAZING * own * line.angle
            && (BETWEEN..=1.0 - BETWEEN).contains(&share)
            && is_flat(-1)
            && is_flat(1)
    }

    /// Returns the slope per pixel at the far end of one side.
    fn surface(self, pixel: [usize; 2], line: Line, side: isize) -> f64 {
        let at = |steps: usize| self.at(pixel, line.step, side * steps as isize);
        let pixels = (1..=line.reach).take_while(|steps| at(*steps).is_some());
        let last = pixels.last().unwrap_or(0);
        let first = last - (last / SURFACE).max(1).min(last);
        let ends = at(first).zip(at(last));
        ends.map_or(0.0, |(first_depth, last_depth)| {
            (last_depth - first_depth).abs() / (last - first).max(1) as f64
        })
    }

    fn at(self, [x, y]: [usize; 2], (right, down): (isize, isize), steps: isize) -> Option<f64> {
        let x = x.checked_add_signed(steps * right)?;
        let y = y.checked_add_signed(steps * down)?;
        let inside = x < self.depth.width() && y < self.depth.height();
        let depth = inside.then(|| self.depth.at(x, y))?;
        (depth > 0.0).then(|| f64::from(depth).recip())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [usize; 2] = [80, 60];
    /// A reach of 12 pixels.
    const FOCAL: [f64; 2] = [400.0, 400.0];

    fn map(depth: impl Fn(f64, f64) -> f64) -> DepthMap {
        let [width, height] = SIZE;
        let value = |i: usize| depth((i % width) as f64, (i / width) as f64) as f32;
        DepthMap::new(width, height, (0..width * height).map(value).collect()).unwrap()
    }

    fn flying(depth: impl Fn(f64, f64) -> f64) -> Vec<[usize; 2]> {
        let found = flying_pixels(&map(depth), FOCAL).into_iter().enumerate();
        let found = found.filter(|(_, flying)| *flying);
        found.map(|(i, _)| [i % SIZE[0], i / SIZE[0]]).collect()
    }

    #[test]
    fn a_ramp_between_two_walls() {
        // From 2 m to 4 m, linear over `width` pixels.
        for width in [3.0, 6.0, 9.0] {
            let share = |x: f64| ((x - 40.0) / width + 0.5).clamp(0.0, 1.0);
            for turned in [false, true] {
                let found = flying(|x, y| 2.0 + 2.0 * share(if turned { y + 10.0 } else { x }));
                let at = |pixel: &[usize; 2]| if turned { pixel[1] + 10 } else { pixel[0] };
                let across = if turned { SIZE[0] } else { SIZE[1] };
                let between = (0..80).filter(|x| (0.1..0.9).contains(&share(*x as f64)));
                for place in between {
                    let count = found.iter().filter(|pixel| at(pixel) == place).count();
                    assert_eq!(count, across, "{width} {turned}: {place}");
                }
                let far = |pixel: &&[usize; 2]| (at(pixel) as f64 - 40.0).abs() > 0.5 * width + 1.0;
                assert_eq!(found.iter().find(far), None, "{width} {turned}");
            }
        }
    }

    #[test]
    fn planes_are_no_ramps_however_they_are_seen() {
        // A floor 1.5 m below the camera, and the wall of a corridor 1 m next to it, up to 25 m.
        assert_eq!(flying(|_, y| 150.0 / (y + 6.0)), [[0; 2]; 0]);
        assert_eq!(
            flying(|x, y| (100.0 / (x + 4.0)).min(150.0 / (y + 6.0))),
            [[0; 2]; 0]
        );
        // Its border with a wall that faces the camera.
        assert_eq!(flying(|_, y| (150.0 / (y + 6.0)).min(8.0)), [[0; 2]; 0]);
    }

    #[test]
    fn a_step_without_a_ramp_has_no_pixel_between() {
        let step = |x: f64, _: f64| if x < 40.0 { 2.0 } else { 4.0 };
        assert_eq!(flying(step), [[0; 2]; 0]);
    }

    #[test]
    fn pixels_without_depth_are_none() {
        assert_eq!(flying(|_, _| 0.0), [[0; 2]; 0]);
        assert_eq!(
            flying(|x, y| if (x, y) == (40.0, 30.0) { 2.0 } else { 0.0 }),
            [[0; 2]; 0]
        );
        let one = DepthMap::new(1, 1, vec![2.0]).unwrap();
        assert_eq!(flying_pixels(&one, FOCAL), [false]);
    }
}
