//! Resizing as named libraries do it.

use crate::data::DepthMap;
use crate::error::{Error, Result};
use fast_image_resize::images::{Image, ImageRef};
use fast_image_resize::{FilterType, PixelType, ResizeAlg, ResizeOptions, Resizer};
use image::RgbImage;

/// Bilinear with antialiasing, as PIL's `BILINEAR`.
///
/// # Errors
/// A size of 0.
pub fn resize_rgb(rgb: &RgbImage, width: usize, height: usize) -> Result<RgbImage> {
    if (rgb.width() as usize, rgb.height() as usize) == (width, height) {
        return Ok(rgb.clone());
    }
    let bytes = convolve(
        rgb.as_raw(),
        (rgb.width() as usize, rgb.height() as usize),
        (width, height),
        PixelType::U8x3,
    )?;
    RgbImage::from_raw(width as u32, height as u32, bytes)
        .ok_or_else(|| Error::shape("resized image has the wrong size"))
}

/// Bilinear with antialiasing, as PIL's `BILINEAR` on mode `F`. Where any input pixel under the
/// filter has no measurement the output has none, so that no depth is mixed with a hole.
///
/// # Errors
/// A size of 0.
pub fn resize_depth_bilinear(depth: &DepthMap, width: usize, height: usize) -> Result<DepthMap> {
    let from = (depth.width(), depth.height());
    let filter = |values: Vec<f32>| -> Result<Vec<f32>> {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_ne_bytes()).collect();
        let resized = convolve(&bytes, from, (width, height), PixelType::F32)?;
        Ok(resized
            .as_chunks::<4>()
            .0
            .iter()
            .map(|b| f32::from_ne_bytes(*b))
            .collect())
    };
    let mut values = filter(depth.values().to_vec())?;
    if depth.count() < depth.values().len() {
        let holes = depth.values().iter().map(|&v| f32::from(v == 0.0));
        let touched = filter(holes.collect())?;
        for (value, hole) in values.iter_mut().zip(touched) {
            if hole > 1e-6 {
                *value = 0.0;
            }
        }
    }
    DepthMap::new(width, height, values)
}

/// Nearest, as OpenCV's `INTER_NEAREST`: source index = floor(i x scale).
///
/// # Errors
/// A size of 0.
pub fn resize_depth_nearest(depth: &DepthMap, width: usize, height: usize) -> Result<DepthMap> {
    let source = |i: usize, from: usize, to: usize| {
        ((i as f64 * (from as f64 / to as f64)) as usize).min(from - 1)
    };
    let values = (0..height)
        .flat_map(|y| (0..width).map(move |x| (x, y)))
        .map(|(x, y)| {
            depth.at(
                source(x, depth.width(), width),
                source(y, depth.height(), height),
            )
        })
        .collect();
    DepthMap::new(width, height, values)
}

fn convolve(
    bytes: &[u8],
    from: (usize, usize),
    to: (usize, usize),
    pixel: PixelType,
) -> Result<Vec<u8>> {
    let wrong = |e: &dyn std::fmt::Display| {
        Error::shape(format!(
            "cannot resize {}x{} to {}x{}: {e}",
            from.0, from.1, to.0, to.1
        ))
    };
    let source =
        ImageRef::new(from.0 as u32, from.1 as u32, bytes, pixel).map_err(|e| wrong(&e))?;
    let mut target = Image::new(to.0 as u32, to.1 as u32, pixel);
    let options = ResizeOptions::new().resize_alg(ResizeAlg::Convolution(FilterType::Bilinear));
    Resizer::new()
        .resize(&source, &mut target, &options)
        .map_err(|e| wrong(&e))?;
    Ok(target.into_vec())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halving_is_the_triangle_filter() {
        // PIL halves with the weights 1, 3, 3, 1 over 8 (a triangle of half-width 2 output-scaled).
        let depth = DepthMap::new(8, 1, vec![1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0]).unwrap();
        let half = resize_depth_bilinear(&depth, 4, 1).unwrap();
        let expected = (2.0 + 3.0 * 4.0 + 3.0 * 8.0 + 16.0) / 8.0;
        assert!((half.at(1, 0) - expected).abs() < 1e-5, "{}", half.at(1, 0));
    }

    #[test]
    fn bilinear_never_mixes_a_hole() {
        let mut values = vec![2.0; 64];
        values[27] = 0.0;
        let depth = DepthMap::new(8, 8, values).unwrap();
        let half = resize_depth_bilinear(&depth, 4, 4).unwrap();
        assert!(
            half.values()
                .iter()
                .all(|&v| v == 0.0 || (v - 2.0).abs() < 1e-5)
        );
        assert!(half.count() < 16 && half.count() >= 7);
    }

    #[test]
    fn nearest_takes_the_upper_left_pixel() {
        let depth = DepthMap::new(4, 4, (1..=16).map(|v| v as f32).collect()).unwrap();
        let half = resize_depth_nearest(&depth, 2, 2).unwrap();
        assert_eq!(half.values(), [1.0, 3.0, 9.0, 11.0]);
    }
}
