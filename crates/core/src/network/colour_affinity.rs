//! Affinities of neighbouring pixels, from their colours and the output of the affinity network.

use super::config::CHANGES;
use super::{Basis, Forward, Network};
use crate::error::Error;
use lsdc_kernels::schedule::InTasks;
use rayon::prelude::*;

/// The colour difference at which the affinity is half that of equal colours: 1.5 of 255, in units of the
/// normalised image. This and the next constant were chosen on training frames of NYU Depth v2.
pub const CONTRAST: f64 = 0.026;

/// The smallest affinity across an edge.
pub const LEAST_AFFINITY: f64 = 1e-4;

/// The logarithms of the network's factors are limited to this magnitude.
pub const MAX_LOG_FACTOR: f64 = 7.0;

/// Returns the affinities `[height, width, 2]` of each pixel of a normalised image `[height, width, 3]` to its right and lower
/// neighbour: `e^f a^(1 + g)` with `a = 1 / (1 + (dC / CONTRAST)^2) + LEAST_AFFINITY`, where dC is the colour difference, and
/// (f, g) is the output of the affinity network, `[height, width, CHANGES]`.
pub(super) fn affinities(
    image: &[f32],
    (height, width): (usize, usize),
    changes: Option<&[f32]>,
) -> Vec<f32> {
    let colour = |pixel: usize| &image[3 * pixel..][..3];
    let from_colours = |one: usize, other: usize| {
        let pairs = colour(one).iter().zip(colour(other));
        let square: f32 = pairs.map(|(a, b)| (a - b).powi(2)).sum();
        let contrast = CONTRAST as f32;
        1.0 / (1.0 + square / (contrast * contrast)) + LEAST_AFFINITY as f32
    };
    let limit = MAX_LOG_FACTOR as f32;
    let of_pixel = |pixel: usize| {
        let last = [pixel % width + 1 == width, pixel / width + 1 == height];
        let directions = [(0, last[0], 1), (1, last[1], width)];
        directions.map(|(direction, last, step)| {
            let affinity = from_colours(pixel, if last { pixel } else { pixel + step });
            let Some(changes) = changes else {
                return affinity;
            };
            let changes = &changes[CHANGES * pixel..][..CHANGES];
            let log_factor = changes[direction].clamp(-limit, limit);
            let exponent = 1.0 + changes[2 + direction].clamp(-1.0, 1.0);
            (affinity.ln() * exponent + log_factor).exp()
        })
    };
    let mut affinities = vec![0.0; 2 * height * width];
    let rows = affinities.par_chunks_mut((2 * width).max(1)).enumerate();
    rows.each(|(y, row)| {
        let pairs = row.as_chunks_mut().0.iter_mut().enumerate();
        pairs.for_each(|(x, pair)| *pair = of_pixel(y * width + x));
    });
    affinities
}

/// A stand-in for a network: one basis function, the constant 1, and affinities from the colours alone.
#[derive(Clone, Copy, Debug)]
pub struct ColourAffinity;

#[derive(Debug)]
struct Colours {
    image: Vec<f32>,
    size: (usize, usize),
}

impl Network for ColourAffinity {
    fn forward(&self, image: &[f32], size: (usize, usize)) -> Result<Box<dyn Forward>, Error> {
        Ok(Box::new(Colours {
            image: image.to_vec(),
            size,
        }))
    }
}

impl Forward for Colours {
    fn basis(&self) -> Box<dyn Basis> {
        Box::new(Constant)
    }

    fn affinities(&self) -> (Vec<f32>, (usize, usize)) {
        (affinities(&self.image, self.size, None), self.size)
    }
}

#[derive(Debug)]
struct Constant;

impl Basis for Constant {
    fn at(&self, _: (usize, usize), places: &[[f64; 2]]) -> Vec<f32> {
        vec![1.0; places.len()]
    }

    fn combine(&self, (height, width): (usize, usize), weights: &[f64]) -> Vec<f32> {
        vec![weights.first().map_or(0.0, |w| *w as f32); height * width]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unlike_colours_are_joined_weakly() {
        let half = CONTRAST as f32;
        let image = [0.0, 0.0, 0.0, half, 0.0, 0.0, 9.0, 9.0, 9.0, 9.0, 9.0, 9.0];
        let found = affinities(&image, (2, 2), None);
        // Right and lower neighbour of each pixel; the last column and row have none.
        let expected = [0.5001, 1e-4, 1.0001, 1e-4, 1.0001, 1.0001, 1.0001, 1.0001];
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-4, "{found} {expected}");
        }
    }
}
