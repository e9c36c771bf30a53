//! Depths and errors as colours.

use crate::data::DepthMap;
use image::{Rgb, RgbImage};

/// The turbo colour map (Mikhailov 2019) from `low` (blue) to `high` (red) metres, in the approximation
/// of d3, which is up to 34 levels of 255 from the published table; black where there is no depth.
pub fn coloured(depth: &DepthMap, low: f32, high: f32) -> RgbImage {
    let span = (high - low).max(f32::EPSILON);
    painted(depth, |d| {
        (d > 0.0).then(|| colorous::TURBO.eval_continuous(share((d - low) / span)))
    })
}

/// A red-blue colour map from -`most` (blue) over 0 (white) to `most` (red), of values row by row.
pub fn signed(values: &[f32], width: usize, most: f32) -> RgbImage {
    let height = values.len() / width.max(1);
    RgbImage::from_fn(width as u32, height as u32, |x, y| {
        let value = values[y as usize * width + x as usize] / most.max(f32::EPSILON);
        let colour = colorous::RED_BLUE.eval_continuous(share(0.5 - 0.5 * value));
        Rgb(colour.into_array())
    })
}

/// The inferno colour map from 0 (black) to `high` metres (yellow); grey where there is no truth.
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

fn painted(depth: &DepthMap, colour: impl Fn(f32) -> Option<colorous::Color>) -> RgbImage {
    RgbImage::from_fn(depth.width() as u32, depth.height() as u32, |x, y| {
        let value = depth.at(x as usize, y as usize);
        Rgb(colour(value).map_or([0; 3], colorous::Color::into_array))
    })
}

fn share(value: f32) -> f64 {
    f64::from(value.clamp(0.0, 1.0))
}
