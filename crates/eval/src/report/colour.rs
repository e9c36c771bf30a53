//! Depths and errors in colour.

use crate::data::DepthMap;
use image::{Rgb, RgbImage};

/// Colours depths with the turbo map (Mikhailov 2019) from `low` (blue) to `high` (red) metres, in the approximation of d3,
/// which differs by up to 34 levels of 255 from the published table; black at pixels without depth.
pub fn coloured(depth: &DepthMap, low: f32, high: f32) -> RgbImage {
    let span = (high - low).max(f32::EPSILON);
    RgbImage::from_fn(depth.width() as u32, depth.height() as u32, |x, y| {
        let depth = depth.at(x as usize, y as usize);
        if depth == 0.0 {
            return Rgb([0; 3]);
        }
        let colour = colorous::TURBO.eval_continuous(share((depth - low) / span));
        Rgb(colour.into_array())
    })
}

/// Colours values, given row by row, with a diverging map from -`limit` (blue) over 0 (white) to `limit` (red).
pub fn diverging(values: &[f32], width: usize, limit: f32) -> RgbImage {
    let height = values.len() / width.max(1);
    RgbImage::from_fn(width as u32, height as u32, |x, y| {
        let value = values[y as usize * width + x as usize] / limit.max(f32::EPSILON);
        let colour = colorous::RED_BLUE.eval_continuous(share(0.5 - 0.5 * value));
        Rgb(colour.into_array())
    })
}

/// Colours errors with the inferno map from 0 (black) to `high` metres (yellow); grey at pixels without true depth.
pub(super) fn errors(prediction: &DepthMap, truth: &DepthMap, high: f32) -> RgbImage {
    let (width, height) = (truth.width() as u32, truth.height() as u32);
    RgbImage::from_fn(width, height, |x, y| {
        let (x, y) = (x as usize, y as usize);
        let depth = truth.at(x, y);
        if depth == 0.0 {
            return Rgb([120; 3]);
        }
        let error = (prediction.at(x, y) - depth).abs() / high.max(f32::EPSILON);
        Rgb(colorous::INFERNO.eval_continuous(share(error)).into_array())
    })
}

fn share(value: f32) -> f64 {
    f64::from(value.clamp(0.0, 1.0))
}
