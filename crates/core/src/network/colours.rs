//! Affinities of neighbouring pixels, from their colours and the output of the affinity network.

use super::config::CHANGES;
use lsdc_kernels::schedule::InTasks;
use rayon::prelude::*;

/// The colour difference at which the affinity is half that of equal colours: 1.5 of 255, in units of the
/// normalised image. This and the next constant were chosen on training frames of NYU Depth v2.
pub const CONTRAST: f64 = 0.026;

/// The smallest affinity across an edge.
pub const LEAST: f64 = 1e-4;

/// The factors from the network are limited to e to the power of this.
pub const MOST_CHANGE: f64 = 7.0;

/// The affinities `[height, width, 2]` of each pixel of a normalised image `[height, width, 3]` with its
/// right and lower neighbour: `a = 1 / (1 + (dC / CONTRAST)^2) + LEAST`, where dC is the colour difference;
/// given the output (f, g) of the affinity network, `[height, width, CHANGES]`, `e^f a^(1 + g)`.
pub(super) fn affinities(
    image: &[f32],
    (height, width): (usize, usize),
    changes: Option<&[f32]>,
) -> Vec<f32> {
    let colour = |pixel: usize| &image[3 * pixel..][..3];
    let alike = |one: usize, other: usize| {
        let pairs = colour(one).iter().zip(colour(other));
        let square: f32 = pairs.map(|(a, b)| (a - b).powi(2)).sum();
        let contrast = CONTRAST as f32;
        1.0 / (1.0 + square / (contrast * contrast)) + LEAST as f32
    };
    let most = MOST_CHANGE as f32;
    let of_pixel = |pixel: usize| {
        let last = [pixel % width + 1 == width, pixel / width + 1 == height];
        let ways = [(0, last[0], 1), (1, last[1], width)];
        ways.map(|(way, last, step)| {
            let alike = alike(pixel, if last { pixel } else { pixel + step });
            match changes {
                None => alike,
                Some(changes) => {
                    let changes = &changes[CHANGES * pixel..][..CHANGES];
                    let factor = changes[way].clamp(-most, most);
                    let more = changes[2 + way].clamp(-1.0, 1.0);
                    (alike.ln() * (1.0 + more) + factor).exp()
                }
            }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unlike_colours_are_joined_weakly() {
        let half = CONTRAST as f32;
        let image = [0.0, 0.0, 0.0, half, 0.0, 0.0, 9.0, 9.0, 9.0, 9.0, 9.0, 9.0];
        let found = affinities(&image, (2, 2), None);
        // Right, down of each pixel; the last column and row have no neighbour.
        let expected = [0.5001, 1e-4, 1.0001, 1e-4, 1.0001, 1.0001, 1.0001, 1.0001];
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-4, "{found} {expected}");
        }
    }
}
