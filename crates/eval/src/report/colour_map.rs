//! A coloured depth map with its colour scale.

use super::colour::coloured;
use super::drawing::Drawing;
use super::panels::ColourScale;
use crate::data::DepthMap;
use image::{RgbImage, imageops};
use lsdc_files::error::{Error, Result};

/// Drawing units: the height of the strip below a map, and the width of its scale.
const STRIP_HEIGHT: f64 = 20.0;
const WIDTH: f64 = 290.0;
/// Width above which letters are enlarged, in pixels.
const REFERENCE_WIDTH: f64 = 640.0;

/// Returns the usual range of colours: the middle 98 % of the depths, so that a few outliers do not compress the scale. `None`
/// without a depth.
pub fn usual_range(depth: &DepthMap) -> Option<(f32, f32)> {
    let mut depths: Vec<f32> = depth.points().map(|point| point.depth).collect();
    if depths.is_empty() {
        return None;
    }
    let last = (depths.len() - 1) as f64;
    let mut at = |share: f64| {
        let place = (last * share).round() as usize;
        *depths.select_nth_unstable_by(place, f32::total_cmp).1
    };
    Some((at(0.01), at(0.99)))
}

/// Returns a depth map in [colours](coloured) from `low` to `high`, above a strip with their scale. `unit` is the unit of the
/// depths. The strip has an even number of rows.
///
/// # Errors
/// None for valid maps.
pub fn colour_map(depth: &DepthMap, low: f32, high: f32, unit: &'static str) -> Result<RgbImage> {
    let map = coloured(depth, low, high);
    let (width, height) = map.dimensions();
    let pixels_per_unit = (f64::from(width) / WIDTH)
        .min(1.0)
        .max(f64::from(width) / REFERENCE_WIDTH);
    let mut drawing = Drawing {
        title: "scale of depths".to_owned(),
        width: f64::from(width) / pixels_per_unit,
        height: STRIP_HEIGHT,
        body: String::new(),
    };
    let scale = ColourScale {
        name: "depth".to_owned(),
        low,
        high,
        unit,
        map: colorous::TURBO,
    };
    scale.draw(&mut drawing.body, 4.0, 4.0);
    let strip = drawing.image(pixels_per_unit as f32)?;
    let strip_height = strip.height().next_multiple_of(2);
    let mut pixels = map.into_raw();
    pixels.resize(3 * width as usize * (height + strip_height) as usize, 255);
    let combined = RgbImage::from_raw(width, height + strip_height, pixels);
    let mut combined = combined.ok_or_else(|| Error::shape("a depth map of no size"))?;
    imageops::replace(&mut combined, &strip, 0, i64::from(height));
    Ok(combined)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_few_stray_pixels_do_not_widen_the_range() {
        let values: Vec<f32> = (0..1001).map(|i| 1.0 + i as f32 / 1000.0).collect();
        let map = |values: &[f32]| DepthMap::new(values.len(), 1, values.to_vec()).unwrap();
        // numpy.percentile(values, [1, 99])
        assert_eq!(usual_range(&map(&values)), Some((1.01, 1.99)));
        let stray = [&values[..], &[0.01, 0.0, 90.0, 0.0]].concat();
        let (low, high) = usual_range(&map(&stray)).unwrap();
        assert!((low - 1.01).abs() < 2e-3 && (high - 1.99).abs() < 2e-3);
        assert_eq!(usual_range(&map(&[0.0, 2.0])), Some((2.0, 2.0)));
        assert_eq!(usual_range(&DepthMap::empty(3, 2)), None);
    }

    #[test]
    fn the_scale_is_below_the_map_at_every_size() {
        for (width, height) in [(20, 16), (304, 228), (1280, 960)] {
            let values = (0..width * height).map(|i| 1.0 + (i % width) as f32);
            let depth = DepthMap::new(width, height, values.collect()).unwrap();
            let (low, high) = (1.0, width as f32);
            let combined = colour_map(&depth, low, high, "m").unwrap();
            let map = imageops::crop_imm(&combined, 0, 0, width as u32, height as u32).to_image();
            assert_eq!(map, coloured(&depth, low, high));
            let strip = combined.height() - height as u32;
            assert_eq!(strip % 2, 0);
            // Blue, red, and black on white.
            let pixels: Vec<_> = combined
                .rows()
                .skip(height)
                .flatten()
                .map(|p| p.0)
                .collect();
            let any = |is: fn([u8; 3]) -> bool| pixels.iter().any(|&p| is(p));
            assert!(any(|p| p == [255; 3]), "{width}");
            if width > 300 {
                assert!(any(|[r, _, b]| b > 150 && r < 100), "{width}");
                assert!(any(|[r, _, b]| r > 120 && b < 60), "{width}");
                assert!(any(|[r, g, b]| r.max(g).max(b) < 110), "{width}");
            }
        }
    }
}
