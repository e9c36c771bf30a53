//! The voxel size that the data resolve.

use crate::error::{Error, Result};
use crate::frame::Frame;
use crate::settings::Settings;

/// A voxel size, and the statistics from which it was derived.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VoxelSize {
    /// Edge length of a voxel.
    pub edge: f64,
    /// The median distance on the surface between neighbouring pixels, for a surface that faces the camera.
    pub footprint: f64,
    /// The median standard deviation of the depths, if the frames have them.
    pub deviation: Option<f64>,
}

/// The voxel size that the data resolve: twice the median footprint of a pixel (two samples per voxel along every axis), or
/// half the median standard deviation, whichever is larger; rounded to two digits.
///
/// # Errors
/// No pixel has a depth within the limits of the settings.
pub fn voxel_size(frames: &[Frame<'_>], settings: &Settings) -> Result<VoxelSize> {
    let (mut footprints, mut deviations) = (Vec::new(), Vec::new());
    for frame in frames {
        let [fx, fy] = frame.camera.focal();
        let focal = f64::midpoint(fx, fy);
        for (index, depth) in frame.depth.values().iter().enumerate() {
            let depth = f64::from(*depth);
            if depth <= 0.0 || depth > settings.max_depth {
                continue;
            }
            let deviation = frame
                .deviation
                .map(|deviations| f64::from(deviations[index]));
            let is_usable = |sigma: f64| sigma > 0.0 && sigma <= settings.max_deviation * depth;
            if deviation.is_none_or(is_usable) {
                footprints.push(depth / focal);
                deviations.extend(deviation);
            }
        }
    }
    let footprint = median(footprints).ok_or(Error::NoPixels)?;
    let deviation = median(deviations);
    Ok(VoxelSize {
        edge: two_digits((2.0 * footprint).max(0.5 * deviation.unwrap_or(0.0))),
        footprint,
        deviation,
    })
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

fn two_digits(value: f64) -> f64 {
    let unit = 10.0_f64.powf(value.log10().floor() - 1.0);
    let rounded = (value / unit).round() * unit;
    if rounded > 0.0 { rounded } else { value }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsdc_core::{Camera, DepthMap};

    #[test]
    fn the_footprint_or_the_deviation_decides() {
        let depth = DepthMap::new(2, 2, vec![2.0, 2.0, 2.0, 0.0]).unwrap();
        let camera = Camera::pinhole([160.0, 160.0], [0.5, 0.5]);
        let size = |deviation: Option<&[f32]>| {
            let frame = Frame {
                depth: &depth,
                deviation,
                camera: &camera,
                image: None,
            };
            voxel_size(&[frame], &Settings::default())
        };
        // 2 * 2 / 160.
        assert!((size(None).unwrap().edge - 0.025).abs() < 1e-12);
        assert!((size(Some(&[0.02; 4])).unwrap().edge - 0.025).abs() < 1e-12);
        let coarse = size(Some(&[0.09; 4])).unwrap();
        assert!((coarse.edge - 0.045).abs() < 1e-9 && (coarse.footprint - 0.0125).abs() < 1e-12);
        // More than a tenth of the depth.
        assert!(matches!(size(Some(&[0.3; 4])), Err(Error::NoPixels)));
    }
}
