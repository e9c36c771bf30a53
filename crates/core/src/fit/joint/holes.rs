//! Holes of dense depths, and limits on the contribution of basis functions in them.
//!
//! In a hole the field continues from its surroundings, and basis functions add their differences between the hole and these.
//! They may be far off if the image in the hole is unlike any observed part. The field of the depths alone, without basis
//! functions, is a weighted mean of the surrounding depths, so it is within their range. The contribution of basis functions is
//! kept up to a margin beyond that range, and is reduced the more it exceeds the margin: basis functions that contradict the
//! surroundings so clearly are outliers, and only the field of the depths remains.

use crate::bilinear::InterpolationWeights;
use lsdc_kernels::schedule::InTasks;
use rayon::prelude::*;

/// Least share of observed pixels for which the rest counts as holes.
const DENSE: f64 = 0.15;
/// Radius of the surroundings of a hole, in pixels of the image.
const REACH: f64 = 15.0;
/// Factor by which depth may be below the nearest or above the farthest surrounding depth: in an enclosed hole, and in a hole
/// at the border of the image, beyond which floors and walls continue.
const ENCLOSED: f64 = 1.2;
const OPEN: f64 = 2.0;

/// The pixels of a grid without an observation, among dense observations.
pub(super) struct Holes {
    /// The pixels.
    pixels: Vec<u32>,
    /// The hole of each of these pixels.
    of_pixels: Vec<u32>,
    /// The smallest and the largest allowed value in each hole.
    bounds: Vec<[f64; 2]>,
}

impl Holes {
    /// Finds the holes among observations with these depths on a grid of `size` (height, width), in an image of the height
    /// `high`; `None` if observations are sparse.
    pub(super) fn new(
        interpolation: &[InterpolationWeights],
        depths: &[f64],
        size: (usize, usize),
        high: usize,
    ) -> Option<Self> {
        let (height, width) = size;
        let mut known = vec![f64::NAN; height * width];
        for (interpolation, &depth) in interpolation.iter().zip(depths) {
            known[interpolation.nearest() as usize] = depth;
        }
        let empty = known.iter().filter(|depth| depth.is_nan()).count();
        if empty == 0 || ((known.len() - empty) as f64) < DENSE * known.len() as f64 {
            return None;
        }
        let (labels, holes) = labelled(&known, size);
        let reach = (REACH * height as f64 / high.max(1) as f64).min(REACH);
        let ranges = ranges(&known, &labels, &holes, size, reach);
        let bounds = holes.iter().zip(ranges).map(|(hole, [low, high])| {
            let margin = if hole.open { OPEN } else { ENCLOSED };
            // Without surrounding depths, the range is 0 to infinity.
            let [one, other] = [low / margin, high * margin];
            [one.min(other), one.max(other)]
        });
        let bounds = bounds.collect();
        let pixels: Vec<u32> = holes.into_iter().flat_map(|hole| hole.pixels).collect();
        let of_pixels = pixels.iter().map(|&pixel| labels[pixel as usize]).collect();
        Some(Self {
            pixels,
            of_pixels,
            bounds,
        })
    }

    /// Returns the pixels in holes.
    pub(super) fn pixels(&self) -> &[u32] {
        &self.pixels
    }

    /// Changes the field at pixels in holes, to which `functions` are added, so that their sum is within its bounds. `alone` is
    /// the field of the observations without functions. Returns the number of changed pixels.
    pub(super) fn limit(
        &self,
        functions: &[f64],
        field: &mut [f64],
        alone: impl FnOnce() -> Vec<f64>,
    ) -> usize {
        let bounds = self
            .of_pixels
            .iter()
            .map(|&hole| self.bounds[hole as usize]);
        let sums = self.pixels.iter().zip(functions);
        let beyond: Vec<_> = sums
            .map(|(&pixel, &function)| (pixel as usize, function))
            .zip(bounds)
            .filter(|&((pixel, function), [low, high])| {
                !(low..=high).contains(&(field[pixel] + function))
            })
            .collect();
        if beyond.is_empty() {
            return 0;
        }
        let alone = alone();
        for &((pixel, function), [low, high]) in &beyond {
            let base = alone[pixel].clamp(low, high);
            let added = field[pixel] + function - base;
            let room = if added > 0.0 { high - base } else { low - base };
            field[pixel] = base + room * (room / added) - function;
        }
        beyond.len()
    }
}

/// Connected pixels without depth; pixels are connected by a side or a corner.
struct Hole {
    pixels: Vec<u32>,
    /// Whether it touches the border of the image.
    open: bool,
}

/// No hole.
const NONE: u32 = u32::MAX;

/// The hole of each pixel, and all holes.
fn labelled(known: &[f64], (height, width): (usize, usize)) -> (Vec<u32>, Vec<Hole>) {
    let mut labels = vec![NONE; known.len()];
    let mut holes = Vec::new();
    for first in 0..known.len() {
        if labels[first] != NONE || !known[first].is_nan() {
            continue;
        }
        let label = holes.len() as u32;
        labels[first] = label;
        let mut hole = Hole {
            pixels: vec![first as u32],
            open: false,
        };
        let mut next = 0;
        while let Some(&pixel) = hole.pixels.get(next) {
            next += 1;
            let (x, y) = (pixel as usize % width, pixel as usize / width);
            hole.open |= x == 0 || y == 0 || x + 1 == width || y + 1 == height;
            for v in y.saturating_sub(1)..(y + 2).min(height) {
                for u in x.saturating_sub(1)..(x + 2).min(width) {
                    let other = v * width + u;
                    if labels[other] == NONE && known[other].is_nan() {
                        labels[other] = label;
                        hole.pixels.push(other as u32);
                    }
                }
            }
        }
        holes.push(hole);
    }
    (labels, holes)
}

/// An empty range.
const NOTHING: [f64; 2] = [f64::INFINITY, 0.0];

fn joined([low, high]: [f64; 2], [l, h]: [f64; 2]) -> [f64; 2] {
    // Not `min` and `max`, which would check for NaN.
    [
        if l < low { l } else { low },
        if h > high { h } else { high },
    ]
}

/// The nearest and the farthest depth within `reach` pixels of each hole.
fn ranges(
    known: &[f64],
    labels: &[u32],
    holes: &[Hole],
    (height, width): (usize, usize),
    reach: f64,
) -> Vec<[f64; 2]> {
    let around = ranges_around(known, (height, width), reach);
    let is_rim = |pixel: u32| {
        let (x, y) = (pixel as usize % width, pixel as usize / width);
        let mut rows = y.saturating_sub(1)..(y + 2).min(height);
        let columns = x.saturating_sub(1)..(x + 2).min(width);
        rows.any(|v| labels[v * width..][columns.clone()].contains(&NONE))
    };
    let of_hole = |hole: &Hole| {
        // The range of a hole's rim includes that of its inner pixels.
        let rim = hole.pixels.iter().filter(|&&pixel| is_rim(pixel));
        let ranges = rim.map(|&pixel| around[pixel as usize]);
        ranges.fold(NOTHING, joined)
    };
    holes.iter().map(of_hole).collect()
}

/// Returns the nearest and the farthest depth within `reach` pixels of each pixel. A disc is a stack of runs, one per row, and
/// the extremes of a run are those of two runs of a power-of-two length, which all discs share.
fn ranges_around(known: &[f64], (height, width): (usize, usize), reach: f64) -> Vec<[f64; 2]> {
    /// Rows of a task.
    const STRIP: usize = 32;
    let beyond = reach as usize;
    // Half width of a disc in each row above and below its centre.
    let halves: Vec<usize> = (0..=beyond)
        .map(|row| (reach * reach - (row * row) as f64).sqrt() as usize)
        .collect();
    let mut found = vec![NOTHING; height * width];
    let strips = found.par_chunks_mut((STRIP * width).max(1)).enumerate();
    strips.each(|(strip, found)| {
        let (first, rows) = (strip * STRIP, found.len() / width);
        let mut runs = Vec::new();
        for y in first.saturating_sub(beyond)..(first + rows + beyond).min(height) {
            runs_of_powers(&known[y * width..][..width], beyond, &mut runs);
            let mut last = None;
            let mut extremes = Vec::new();
            for (off, &half) in halves.iter().enumerate() {
                if last != Some(half) {
                    let power = (2 * half + 1).ilog2();
                    let run = &runs[power as usize];
                    let one = &run[beyond - half..][..width];
                    let other = &run[beyond + half + 1 - (1 << power)..][..width];
                    extremes.clear();
                    let pairs = one.iter().zip(other);
                    extremes.extend(pairs.map(|(one, other)| joined(*one, *other)));
                    last = Some(half);
                }
                let below = (off > 0).then_some(y + off);
                for target in y.checked_sub(off).into_iter().chain(below) {
                    let row = target.wrapping_sub(first);
                    if row < rows {
                        let targets = found[row * width..][..width].iter_mut();
                        let pairs = targets.zip(&extremes);
                        pairs.for_each(|(range, more)| *range = joined(*range, *more));
                    }
                }
            }
        }
    });
    found
}

/// Computes the ranges of runs of 1, 2, 4, ... values of a row, NaN for missing values, with `beyond` more values on both
/// sides, for lengths up to `2 beyond + 1`.
fn runs_of_powers(row: &[f64], beyond: usize, runs: &mut Vec<Vec<[f64; 2]>>) {
    runs.clear();
    let mut run = vec![NOTHING; row.len() + 2 * beyond];
    for (range, &depth) in run[beyond..].iter_mut().zip(row) {
        if !depth.is_nan() {
            *range = [depth; 2];
        }
    }
    let mut length = 1;
    while 2 * length <= 2 * beyond + 1 {
        let pairs = run.iter().zip(&run[length..]);
        let longer = pairs.map(|(one, other)| joined(*one, *other)).collect();
        runs.push(std::mem::replace(&mut run, longer));
        length *= 2;
    }
    runs.push(run);
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsdc_rng::Rng;

    const SIZE: (usize, usize) = (40, 50);

    /// Depths of 2 m on the left and 3 m on the right, but for holes.
    fn holes(is_hole: impl Fn(usize, usize) -> bool) -> Option<Holes> {
        let pixels = (0..SIZE.0 * SIZE.1).filter(|i| !is_hole(i % SIZE.1, i / SIZE.1));
        let pixels: Vec<usize> = pixels.collect();
        let interpolation: Vec<InterpolationWeights> = pixels
            .iter()
            .map(|&i| InterpolationWeights::pixel(i as u32))
            .collect();
        let depth = |&i: &usize| if i % SIZE.1 < 25 { 2.0 } else { 3.0 };
        let depths: Vec<f64> = pixels.iter().map(depth).collect();
        Holes::new(&interpolation, &depths, SIZE, SIZE.0)
    }

    #[test]
    fn ranges_are_those_of_discs() {
        let mut rng = Rng::stream(0, &["holes"]);
        let (height, width) = SIZE;
        let depth = |rng: &mut Rng| {
            let known = rng.unit() < 0.05;
            let depth = 1.0 + f64::from(rng.unit());
            if known { depth } else { f64::NAN }
        };
        let known: Vec<f64> = (0..height * width).map(|_| depth(&mut rng)).collect();
        for reach in [0.0, 1.0, 2.5, 7.1, 15.0, 80.0] {
            let found = ranges_around(&known, SIZE, reach);
            for (pixel, found) in found.into_iter().enumerate() {
                let off = |other: usize| {
                    let across = (other % width).abs_diff(pixel % width);
                    let down = (other / width).abs_diff(pixel / width);
                    (across * across + down * down) as f64
                };
                let inside = (0..known.len()).filter(|&other| off(other) <= reach * reach);
                let depths = inside.map(|other| known[other]).filter(|d| !d.is_nan());
                let expected = depths.fold(NOTHING, |[low, high], depth| {
                    [low.min(depth), high.max(depth)]
                });
                assert_eq!(found, expected, "{reach} {pixel}");
            }
        }
    }

    #[test]
    fn bounds_are_those_of_the_depths_around() {
        // One hole far from the farther depths, one at both, one at the border.
        let inside = |x: usize, y: usize, left, top| {
            (left..left + 3).contains(&x) && (top..top + 3).contains(&y)
        };
        let found =
            holes(|x, y| inside(x, y, 2, 20) || inside(x, y, 23, 20) || inside(x, y, 47, 30))
                .unwrap();
        let at = |x: usize, y: usize| {
            let pixel = (y * SIZE.1 + x) as u32;
            let place = found.pixels().iter().position(|&p| p == pixel).unwrap();
            found.bounds[found.of_pixels[place] as usize]
        };
        assert_eq!(at(3, 21), [2.0 / 1.2, 2.0 * 1.2]);
        assert_eq!(at(24, 20), [2.0 / 1.2, 3.0 * 1.2]);
        assert_eq!(at(49, 32), [3.0 / 2.0, 3.0 * 2.0]);
    }

    #[test]
    fn what_is_within_the_bounds_stays_and_what_is_far_beyond_becomes_the_field_alone() {
        let found = holes(|x, y| (2..5).contains(&x) && y == 20).unwrap();
        assert_eq!(found.pixels().len(), 3);
        let alone = || vec![2.0; SIZE.0 * SIZE.1];
        let mut field = vec![2.0; SIZE.0 * SIZE.1];
        let changed = found.limit(&[0.3, -0.2, 0.4], &mut field, alone);
        assert_eq!((changed, &field), (0, &alone()));
        // Twice and a hundred times as far off as the bound.
        let functions = [0.8, 40.0, -0.1];
        assert_eq!(found.limit(&functions, &mut field, alone), 2);
        let sums: Vec<f64> = found
            .pixels()
            .iter()
            .zip(functions)
            .map(|(&p, f)| field[p as usize] + f)
            .collect();
        for (sum, expected) in sums.iter().zip([2.2, 2.004, 1.9]) {
            assert!((sum - expected).abs() < 1e-12, "{sums:?}");
        }
    }

    #[test]
    fn sparse_observations_have_no_holes() {
        assert!(holes(|x, y| x % 2 + y % 2 > 0).is_some());
        assert!(holes(|x, y| x % 3 + y % 3 > 0).is_none());
        assert!(holes(|_, _| false).is_none());
    }
}
