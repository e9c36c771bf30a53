//! Where points lie in their image.

use crate::bilinear::neighbours;
use crate::field::Grid;

/// How strongly the pixels of an image are joined to their neighbours.
#[derive(Clone, Debug)]
pub struct Edges {
    height: usize,
    width: usize,
    right: Vec<f64>,
    down: Vec<f64>,
}

impl Edges {
    /// From `[height, width, 2]`: the strength of each pixel and its right neighbour, and the one
    /// below.
    ///
    /// # Panics
    /// If there are not as many strengths.
    pub fn new((height, width): (usize, usize), strengths: &[f32]) -> Self {
        assert_eq!(strengths.len(), 2 * height * width, "strengths");
        let every = |first: usize| {
            let some = strengths.iter().skip(first).step_by(2);
            some.map(|&v| f64::from(v)).collect()
        };
        Self {
            height,
            width,
            right: every(0),
            down: every(1),
        }
    }

    /// Height and width.
    pub fn size(&self) -> (usize, usize) {
        (self.height, self.width)
    }

    pub(super) fn grid(&self, level: f64) -> Grid<'_> {
        Grid {
            height: self.height,
            width: self.width,
            right: &self.right,
            down: &self.down,
            level,
        }
    }

    /// The pixel at which (x, y) of a map of `size` (height, width) lies.
    pub(super) fn pixel(&self, [x, y]: [usize; 2], size: (usize, usize)) -> u32 {
        let (column, row) = (
            scaled(x, size.1, self.width),
            scaled(y, size.0, self.height),
        );
        (row * self.width + column) as u32
    }
}

/// The pixel on an axis of length `to` that holds the centre of pixel `i` of one of length `from`.
fn scaled(i: usize, from: usize, to: usize) -> usize {
    ((2 * i + 1) * to / (2 * from).max(1)).min(to.saturating_sub(1))
}

/// The edges of the image that points lie in, and the height and width in which their places count.
#[derive(Clone, Copy, Debug)]
pub struct Scene<'a> {
    /// Of the image, at any size.
    pub edges: &'a Edges,
    /// Of the map that the points come from.
    pub size: (usize, usize),
}

/// A smooth field, read at any size.
#[derive(Clone, Debug, PartialEq)]
pub struct Smooth {
    height: usize,
    width: usize,
    values: Vec<f32>,
}

impl Smooth {
    pub(super) fn new((height, width): (usize, usize), values: &[f64]) -> Self {
        let values = values.iter().map(|&v| v as f32).collect();
        Self {
            height,
            width,
            values,
        }
    }

    /// Adds the field to a map of `size` (height, width), by bilinear interpolation between pixel
    /// centres.
    pub fn add_to(&self, size: (usize, usize), map: &mut [f32]) {
        let columns: Vec<_> = (0..size.1)
            .map(|x| neighbours(x, size.1, self.width))
            .collect();
        for (y, row) in map.chunks_exact_mut(size.1.max(1)).enumerate() {
            let (top, bottom, v) = neighbours(y, size.0, self.height);
            let [upper, lower] = [top, bottom].map(|y| &self.values[y * self.width..]);
            for (value, &(left, right, u)) in row.iter_mut().zip(&columns) {
                let along = |row: &[f32]| row[left] * (1.0 - u) + row[right] * u;
                *value += along(upper) * (1.0 - v) + along(lower) * v;
            }
        }
    }
}
