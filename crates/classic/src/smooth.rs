//! Weighted least squares (Farbman, Fattal, Lischinski, Szeliski 2008, with sparse data): the map u
//! that minimises
//!
//! > sum over neighbours w_ij (u_i - u_j)^2 + OBSERVATION_PRECISION x sum over points (u_i - d_i)^2
//!
//! where `w_ij` decreases with the difference in colour.

use crate::error::{Error, Result};
use image::RgbImage;
use lsdc_core::DepthMap;
use lsdc_core::bilinear::InterpolationWeights;
use lsdc_core::field::{Grid, PrecisionSolver};

/// Difference in colour (of 255 per channel) that halves an affinity. This and the next constant were chosen on training frames
/// of NYU Depth v2.
const CONTRAST: f64 = 1.5;

/// The smallest affinity, across edges.
const LEAST_AFFINITY: f64 = 5e-4;

/// The weight of a point relative to the smoothness: the surface nearly interpolates the points.
const OBSERVATION_PRECISION: f64 = 100.0;

pub(super) fn smooth(rgb: &RgbImage, sparse: &DepthMap) -> Result<DepthMap> {
    let (width, height) = (sparse.width(), sparse.height());
    let colour = |i: usize| rgb.get_pixel((i % width) as u32, (i / width) as u32).0;
    let affinities = |step: usize, last: &dyn Fn(usize) -> bool| -> Vec<f64> {
        let of_pixel = |i| {
            if last(i) {
                0.0
            } else {
                affinity(colour(i), colour(i + step))
            }
        };
        (0..width * height).map(of_pixel).collect()
    };
    let (taps, depths): (Vec<InterpolationWeights>, Vec<f64>) = sparse
        .points()
        .map(|point| {
            let pixel = (point.y * width + point.x) as u32;
            (InterpolationWeights::pixel(pixel), f64::from(point.depth))
        })
        .unzip();
    let grid = Grid {
        height,
        width,
        right: &affinities(1, &|i| (i + 1).is_multiple_of(width)),
        down: &affinities(width, &|i| i + width >= width * height),
        diagonal_regularisation: 0.0,
    };
    let field = PrecisionSolver::new(&grid, &taps, &vec![OBSERVATION_PRECISION; taps.len()])
        .ok_or(Error::Singular)?;
    let values = field.extend(&depths).into_iter().map(|v| v as f32);
    Ok(DepthMap::new(width, height, values.collect())?)
}

fn affinity(a: [u8; 3], b: [u8; 3]) -> f64 {
    let differences = a.iter().zip(b).map(|(&a, b)| f64::from(a) - f64::from(b));
    let square: f64 = differences.map(|difference| difference.powi(2)).sum();
    (1.0 / (1.0 + square / (CONTRAST * CONTRAST))).max(LEAST_AFFINITY)
}
