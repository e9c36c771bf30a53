//! Colorisation of depths instead of colours (Levin, Lischinski, Weiss 2004): each pixel without a point is the mean of its
//! eight neighbours, weighted by the similarity of their grey values; pixels with a point keep its depth.

use super::{equations::Equations, grey_values};
use crate::error::Result;
use image::RgbImage;
use lsdc_core::DepthMap;

/// The scale of squared differences as a share of the window's variance, and its least value, for grey values of 0 to 1 (the
/// constants of the authors' program).
const SHARE: f64 = 0.6;
const LEAST: f64 = 2e-6;

pub(super) fn colorisation(rgb: &RgbImage, sparse: &DepthMap) -> Result<DepthMap> {
    let (width, height) = (sparse.width(), sparse.height());
    let grey: Vec<f64> = grey_values(rgb).map(|value| value / 255.0).collect();
    let mut equations = Equations::new(width * height);
    let mut around = Vec::with_capacity(8);
    for y in 0..height {
        for x in 0..width {
            let i = y * width + x;
            equations.add(i, i, 1.0);
            let depth = sparse.at(x, y);
            if depth > 0.0 {
                equations.add_right(i, f64::from(depth));
                continue;
            }
            around.clear();
            for v in y.saturating_sub(1)..(y + 2).min(height) {
                for u in x.saturating_sub(1)..(x + 2).min(width) {
                    if (u, v) != (x, y) {
                        around.push(v * width + u);
                    }
                }
            }
            for (&j, weight) in around.iter().zip(weights(&grey, i, &around)) {
                equations.add(i, j, -weight);
            }
        }
    }
    let values = equations.solve()?.into_iter().map(|v| v as f32);
    Ok(DepthMap::new(width, height, values.collect())?)
}

/// Returns the weights of the neighbours, which sum to 1.
fn weights(grey: &[f64], here: usize, around: &[usize]) -> Vec<f64> {
    let count = around.len() as f64 + 1.0;
    let window = || around.iter().chain([&here]).map(|&j| grey[j]);
    let mean = window().sum::<f64>() / count;
    let variance = window().map(|g| (g - mean).powi(2)).sum::<f64>() / count;
    let squares = around.iter().map(|&j| (grey[j] - grey[here]).powi(2));
    let squares: Vec<f64> = squares.collect();
    let closest = squares.iter().copied().fold(f64::INFINITY, f64::min);
    // The most similar neighbour has a weight of at least 1/100.
    let scale = (SHARE * variance).max(closest / 100_f64.ln()).max(LEAST);
    let weights = squares.iter().map(|square| (-square / scale).exp());
    let weights: Vec<f64> = weights.collect();
    let sum: f64 = weights.iter().sum();
    weights.into_iter().map(|weight| weight / sum).collect()
}
