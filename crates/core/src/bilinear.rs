//! Bilinear interpolation between pixel centres (`align_corners = false`).

/// The two neighbouring pixels, on an axis of `to` pixels, of a position on an axis of `from` pixels, and the
/// weight of the second. Position 0 is the centre of the first pixel; positions beyond the outermost centres
/// take the outermost value.
pub fn neighbours(place: f64, from: usize, to: usize) -> (usize, usize, f64) {
    between((place + 0.5) * (to as f64 / from as f64) - 0.5, to)
}

/// The two neighbours of a position among `count` values at 0, 1, ..., and the weight of the second. Positions beyond
/// the ends take the outermost value.
pub(crate) fn between(position: f64, count: usize) -> (usize, usize, f64) {
    let last = count.saturating_sub(1);
    let position = position.clamp(0.0, last as f64);
    let low = position as usize;
    (low, (low + 1).min(last), position - low as f64)
}

/// The position on an axis of `to` pixels of a position on an axis of `from` pixels.
pub(crate) fn rescaled(place: f64, from: usize, to: usize) -> f64 {
    (place + 0.5) * to as f64 / from.max(1) as f64 - 0.5
}

/// The pixel on an axis of `to` pixels that contains a position on an axis of `from` pixels.
pub(crate) fn containing(place: f64, from: usize, to: usize) -> usize {
    let scaled = (place + 0.5) * to as f64 / from.max(1) as f64;
    (scaled.max(0.0) as usize).min(to.saturating_sub(1))
}

/// The pixels of a grid from which a position is interpolated, and their weights, which add up to 1 (except in a
/// [`difference`](Self::difference)). A position at a pixel's centre uses that pixel alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InterpolationWeights {
    /// Indices `y * width + x`; the first `count` of them are used, and are distinct.
    pixels: [u32; 4],
    shares: [f64; 4],
    count: usize,
}

impl InterpolationWeights {
    /// Interpolates a position (u, v) in an image of `size` (height, width) on a grid of another size.
    pub fn new([u, v]: [f64; 2], size: (usize, usize), grid: (usize, usize)) -> Self {
        let (left, right, across) = neighbours(u, size.1, grid.1);
        let (top, bottom, down) = neighbours(v, size.0, grid.0);
        let mut interpolation = Self {
            pixels: [0; 4],
            shares: [0.0; 4],
            count: 0,
        };
        for (row, vertical) in [(top, 1.0 - down), (bottom, down)] {
            for (column, horizontal) in [(left, 1.0 - across), (right, across)] {
                let share = vertical * horizontal;
                if share > 0.0 {
                    interpolation.pixels[interpolation.count] = (row * grid.1 + column) as u32;
                    interpolation.shares[interpolation.count] = share;
                    interpolation.count += 1;
                }
            }
        }
        interpolation
    }

    /// The weight 1 at a single pixel.
    pub fn pixel(pixel: u32) -> Self {
        Self {
            pixels: [pixel, 0, 0, 0],
            shares: [1.0, 0.0, 0.0, 0.0],
            count: 1,
        }
    }

    /// The value of one pixel minus that of another.
    pub fn difference(one: u32, other: u32) -> Self {
        Self {
            pixels: [one, other, 0, 0],
            shares: [1.0, -1.0, 0.0, 0.0],
            count: 2,
        }
    }

    /// The same pixels, each weight multiplied by a factor above 0, and all divided by their sum.
    #[must_use]
    pub fn weighted(mut self, factor: impl Fn(u32) -> f64) -> Self {
        if self.count < 2 {
            return self;
        }
        let pairs = self.shares.iter_mut().zip(self.pixels);
        for (share, pixel) in pairs.take(self.count) {
            *share *= factor(pixel);
        }
        let total: f64 = self.shares[..self.count].iter().sum();
        self.shares.iter_mut().for_each(|share| *share /= total);
        self
    }

    /// The same position on another grid, where several pixels may map to one: their weights are added.
    #[must_use]
    pub(crate) fn merged(&self, pixel: impl Fn(u32) -> u32) -> Self {
        let mut merged = Self {
            pixels: [0; 4],
            shares: [0.0; 4],
            count: 0,
        };
        for (from, share) in self.iter() {
            let to = pixel(from);
            let known = merged.pixels[..merged.count].iter().position(|p| *p == to);
            let place = known.unwrap_or(merged.count);
            merged.pixels[place] = to;
            merged.shares[place] += share;
            merged.count = merged.count.max(place + 1);
        }
        merged
    }

    /// The pixel, if there is only one.
    pub fn single(&self) -> Option<u32> {
        (self.count == 1).then_some(self.pixels[0])
    }

    /// The pixel with the largest weight; the last one of equal weights.
    pub fn nearest(&self) -> u32 {
        let nearest = self.iter().max_by(|a, b| a.1.total_cmp(&b.1));
        nearest.map_or(0, |(pixel, _)| pixel)
    }

    /// The pixels and their weights.
    pub fn iter(&self) -> impl Iterator<Item = (u32, f64)> + '_ {
        let pixels = self.pixels[..self.count].iter().copied();
        pixels.zip(self.shares[..self.count].iter().copied())
    }

    /// The interpolated value of a map on the grid.
    pub fn read(&self, values: &[f64]) -> f64 {
        self.iter()
            .map(|(pixel, share)| share * values[pixel as usize])
            .sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_lie_between_the_centres_of_others() {
        // Twice as large: pixel 3 has its centre at 3.5 / 2, a quarter of a pixel after centre 1.
        assert_eq!(neighbours(3.0, 8, 4), (1, 2, 0.25));
        // The outermost values apply beyond the first and the last centre.
        assert_eq!(neighbours(0.0, 8, 4), (0, 1, 0.0));
        assert_eq!(neighbours(7.0, 8, 4), (3, 3, 0.0));
        // Half as large: between two centres.
        assert_eq!(neighbours(1.0, 2, 4), (2, 3, 0.5));
    }

    #[test]
    fn a_plane_is_read_exactly_inside() {
        let grid = (30, 40);
        let plane = |u: f64, v: f64| 2.0 + 0.3 * u - 0.1 * v;
        // Centres of the grid in an image of 3/2 of its size.
        let values: Vec<f64> = (0..grid.0 * grid.1)
            .map(|i| ((i % grid.1) as f64, (i / grid.1) as f64))
            .map(|(x, y)| plane((x + 0.5) * 1.5 - 0.5, (y + 0.5) * 1.5 - 0.5))
            .collect();
        for place in [[7.25, 3.5], [20.0, 31.125], [58.0, 43.0]] {
            let interpolation = InterpolationWeights::new(place, (45, 60), grid);
            assert!((interpolation.read(&values) - plane(place[0], place[1])).abs() < 1e-12);
        }
        let on_a_centre = InterpolationWeights::new([12.0, 9.0], grid, grid);
        assert_eq!(on_a_centre.single(), Some(9 * 40 + 12));
    }
}
