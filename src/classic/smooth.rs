//! Weighted least squares (Farbman, Fattal, Lischinski, Szeliski 2008, with sparse data): the map u
//! that minimises
//!
//! > sum over neighbours w_ij (u_i - u_j)^2 + DATA x sum over points (u_i - d_i)^2
//!
//! where `w_ij` falls with the difference in colour.

use super::equations::Equations;
use crate::data::DepthMap;
use crate::error::Result;
use image::RgbImage;

/// Difference in colour (of 255 a channel) at which a weight is half. This and the next were chosen
/// on training frames of NYU Depth v2.
const CONTRAST: f64 = 1.5;

/// The smallest weight: how much still passes an edge.
const LEAST: f64 = 5e-4;

/// How much a point counts against the smoothness: nearly all.
const DATA: f64 = 100.0;

pub(super) fn smooth(rgb: &RgbImage, sparse: &DepthMap) -> Result<DepthMap> {
    let (width, height) = (sparse.width(), sparse.height());
    let mut equations = Equations::new(width * height);
    let colour = |i: usize| rgb.get_pixel((i % width) as u32, (i / width) as u32).0;
    let mut join = |i: usize, j: usize| {
        let weight = alike(colour(i), colour(j));
        equations.add(i, i, weight);
        equations.add(j, j, weight);
        equations.add(j, i, -weight);
    };
    for y in 0..height {
        for x in 0..width {
            let i = y * width + x;
            if x + 1 < width {
                join(i, i + 1);
            }
            if y + 1 < height {
                join(i, i + width);
            }
        }
    }
    for point in sparse.points() {
        let i = point.y * width + point.x;
        equations.add(i, i, DATA);
        equations.add_right(i, DATA * f64::from(point.depth));
    }
    let values = equations.solve_symmetric()?;
    DepthMap::new(
        width,
        height,
        values.into_iter().map(|v| v as f32).collect(),
    )
}

fn alike(a: [u8; 3], b: [u8; 3]) -> f64 {
    let square: f64 = a
        .iter()
        .zip(b)
        .map(|(&a, b)| (f64::from(a) - f64::from(b)).powi(2))
        .sum();
    (1.0 / (1.0 + square / (CONTRAST * CONTRAST))).max(LEAST)
}
