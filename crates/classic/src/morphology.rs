//! IP-Basic (Ku, Harakeh, Waslander, CRV 2018): dilations of inverted depths, which preserve the nearest depths, then a median
//! filter and a Gaussian blur. Its kernel sizes suit a 64-line laser scanner.

use super::neighbours::Neighbours;
use crate::error::Result;
use lsdc_core::DepthMap;

/// Least depth, in metres, from which depths are subtracted to invert them.
const FAR: f32 = 100.0;

/// Rows of the 5x5 diamond: the half width of each.
const DIAMOND: [usize; 5] = [0, 1, 2, 1, 0];

pub(super) fn morphology(sparse: &DepthMap) -> Result<DepthMap> {
    let (width, height) = (sparse.width(), sparse.height());
    // Points farther than `FAR` would change sign.
    let (low, high) = sparse.range().unwrap_or((0.0, 0.0));
    let far = FAR.max(2.0 * high);
    let invert = |&depth: &f32| if depth > 0.0 { far - depth } else { 0.0 };
    let mut map = Plane {
        width,
        height,
        values: sparse.values().iter().map(invert).collect(),
    };
    map = map.dilated(&DIAMOND);
    map = map.dilated(&[2; 5]).eroded(&[2; 5]);
    map = map.filled_from(&map.dilated(&[3; 7]));
    map = map.filled_from(&map.dilated(&[15; 31]));
    let filled: Vec<bool> = map.values.iter().map(|&v| v > 0.0).collect();
    map = map.median();
    let blurred = map.blurred();
    let neighbours = Neighbours::new(sparse);
    let values = (0..width * height)
        .map(|i| {
            if filled[i] {
                // Empty pixels affect the blurred values of their neighbours.
                (far - blurred.values[i]).clamp(low, high)
            } else {
                neighbours.nearest_depth(i % width, i / width)
            }
        })
        .collect();
    Ok(DepthMap::new(width, height, values)?)
}

/// Inverted depths; 0 for empty pixels.
#[derive(Clone)]
struct Plane {
    width: usize,
    height: usize,
    values: Vec<f32>,
}

impl Plane {
    /// Returns the largest value under a shape, given by the half width of each of its rows. Pixels outside the map are
    /// ignored.
    fn dilated(&self, shape: &[usize]) -> Self {
        self.extreme(shape, f32::max)
    }

    /// Returns the smallest value under a shape.
    fn eroded(&self, shape: &[usize]) -> Self {
        self.extreme(shape, f32::min)
    }

    fn extreme(&self, shape: &[usize], pick: impl Fn(f32, f32) -> f32) -> Self {
        let reach = shape.len() / 2;
        let (width, height) = (self.width, self.height);
        // Rows first: the extreme of each run is shared by the rows of a rectangle.
        let mut half_widths = shape.to_vec();
        half_widths.sort_unstable();
        half_widths.dedup();
        let runs = half_widths.iter().map(|&half| self.runs(half, &pick));
        let runs: Vec<Vec<f32>> = runs.collect();
        let values = (0..width * height)
            .map(|i| {
                let (x, y) = (i % width, i / width);
                let rows = y.saturating_sub(reach)..(y + reach + 1).min(height);
                rows.map(|v| {
                    let half = shape[v + reach - y];
                    let run = half_widths.binary_search(&half).unwrap_or_default();
                    runs[run][v * width + x]
                })
                .reduce(&pick)
                .unwrap_or_default()
            })
            .collect();
        Self { values, ..*self }
    }

    /// Returns the extreme of `half` pixels on both sides in the same row.
    fn runs(&self, half: usize, pick: &impl Fn(f32, f32) -> f32) -> Vec<f32> {
        let mut runs = Vec::with_capacity(self.values.len());
        for row in self.values.chunks(self.width) {
            for x in 0..self.width {
                let run = &row[x.saturating_sub(half)..(x + half + 1).min(self.width)];
                runs.push(run.iter().copied().reduce(pick).unwrap_or_default());
            }
        }
        runs
    }

    /// Fills empty pixels from another map.
    fn filled_from(&self, other: &Self) -> Self {
        let pairs = self.values.iter().zip(&other.values);
        Self {
            values: pairs.map(|(&a, &b)| if a > 0.0 { a } else { b }).collect(),
            ..*self
        }
    }

    /// Returns the value at a pixel, with the border replicated.
    fn at(&self, x: isize, y: isize) -> f32 {
        let x = x.clamp(0, self.width as isize - 1) as usize;
        let y = y.clamp(0, self.height as isize - 1) as usize;
        self.values[y * self.width + x]
    }

    /// Returns the median of 5x5 pixels.
    fn median(&self) -> Self {
        let mut window = Vec::with_capacity(25);
        let mut values = Vec::with_capacity(self.values.len());
        for y in 0..self.height as isize {
            for x in 0..self.width as isize {
                window.clear();
                for dy in -2..=2 {
                    window.extend((-2..=2).map(|dx| self.at(x + dx, y + dy)));
                }
                window.sort_unstable_by(f32::total_cmp);
                values.push(window[12]);
            }
        }
        Self { values, ..*self }
    }

    /// Returns a 5x5 binomial blur, which is OpenCV's Gaussian for 5 pixels; the border is mirrored about the outermost pixel.
    fn blurred(&self) -> Self {
        const WEIGHTS: [f32; 5] = [0.0625, 0.25, 0.375, 0.25, 0.0625];
        let mirrored = |i: isize, length: usize| {
            let last = length as isize - 1;
            let i = if i < 0 { -i } else { i };
            (if i > last { 2 * last - i } else { i }).clamp(0, last)
        };
        let pass = |plane: &Self, (sx, sy): (isize, isize)| {
            let mut values = Vec::with_capacity(plane.values.len());
            for y in 0..plane.height as isize {
                for x in 0..plane.width as isize {
                    let mut value = 0.0;
                    for (k, w) in (-2..=2).zip(WEIGHTS) {
                        let u = mirrored(x + k * sx, plane.width);
                        let v = mirrored(y + k * sy, plane.height);
                        value += w * plane.at(u, v);
                    }
                    values.push(value);
                }
            }
            Self { values, ..*plane }
        };
        pass(&pass(self, (1, 0)), (0, 1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plane(at: &[(usize, f32)]) -> Plane {
        let mut values = vec![0.0; 9 * 9];
        for &(i, v) in at {
            values[i] = v;
        }
        Plane {
            width: 9,
            height: 9,
            values,
        }
    }

    #[test]
    fn shapes_spread_and_the_larger_value_wins() {
        let centre = 4 * 9 + 4;
        let diamond = plane(&[(centre, 5.0)]).dilated(&DIAMOND);
        assert_eq!(diamond.values.iter().filter(|v| **v == 5.0).count(), 13);
        let square = plane(&[(centre, 5.0), (centre + 1, 3.0)]).dilated(&[1; 3]);
        assert_eq!(square.values.iter().filter(|v| **v == 5.0).count(), 9);
        assert_eq!(square.values.iter().filter(|v| **v == 3.0).count(), 3);
        // Opening the closed map restores it.
        let back = square.dilated(&[1; 3]).eroded(&[1; 3]);
        assert_eq!(back.values, square.values);
    }
}
