//! Weighted least squares (Farbman, Fattal, Lischinski, Szeliski 2008, with sparse data): the map u
//! that minimises
//!
//! > sum over neighbours w_ij (u_i - u_j)^2 + DATA x sum over points (u_i - d_i)^2
//!
//! where `w_ij` falls with the difference in colour.

use crate::error::{Error, Result};
use image::RgbImage;
use lsdc_core::DepthMap;
use lsdc_core::bilinear::InterpolationWeights;
use lsdc_core::field::{Grid, PrecisionSolver};

/// Difference in colour (of 255 a channel) at which a weight is half. This and the next were chosen
/// on training frames of NYU Depth v2.
const CONTRAST: f64 = 1.5;

/// The smallest weight: how much still passes an edge.
const LEAST: f64 = 5e-4;

/// How much a point counts against the smoothness: nearly all.
const DATA: f64 = 100.0;

pub(super) fn smooth(rgb: &RgbImage, sparse: &DepthMap) -> Result<DepthMap> {
    let (width, height) = (sparse.width(), sparse.height());
    let colour = |i: usize| rgb.get_pixel((i % width) as u32, (i / width) as u32).0;
    let joined = |step: usize, last: &dyn Fn(usize) -> bool| -> Vec<f64> {
        let pixels = 0..width * height;
        let strength = |i| {
            if last(i) {
                0.0
            } else {
                alike(colour(i), colour(i + step))
            }
        };
        pixels.map(strength).collect()
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
        right: &joined(1, &|i| (i + 1).is_multiple_of(width)),
        down: &joined(width, &|i| i + width >= width * height),
        level: 0.0,
    };
    let field =
        PrecisionSolver::new(&grid, &taps, &vec![DATA; taps.len()]).ok_or(Error::Singular)?;
    let values = field.extend(&depths).into_iter().map(|v| v as f32);
    Ok(DepthMap::new(width, height, values.collect())?)
}

fn alike(a: [u8; 3], b: [u8; 3]) -> f64 {
    let square: f64 = a
        .iter()
        .zip(b)
        .map(|(&a, b)| (f64::from(a) - f64::from(b)).powi(2))
        .sum();
    (1.0 / (1.0 + square / (CONTRAST * CONTRAST))).max(LEAST)
}
