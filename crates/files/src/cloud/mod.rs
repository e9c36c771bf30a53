//! Back-projection of a depth map.

mod voxels;

use crate::{Camera, ColoredPoint, DepthMap, DeviationLimits};
use image::RgbImage;
use lsdc_core::cloud::flying_pixels;
use voxels::thinned;

/// Selects the pixels of a map that become points of a cloud.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CloudOptions {
    /// Largest standard deviations; pixels above are left out.
    pub limits: DeviationLimits,
    /// Whether to keep the pixels between the surfaces at a depth edge
    /// ([`flying_pixels`](lsdc_core::cloud::flying_pixels)).
    pub keep_flying: bool,
    /// Edge length of the voxels that keep one point each, in metres, above 0.
    pub voxel: Option<f64>,
}

/// A back-projected depth map, with the colours of the image.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ColoredCloud {
    /// Points of the pixels that are kept, row by row, or one for each voxel.
    pub points: Vec<ColoredPoint>,
    /// Number of pixels left out because their standard deviation is too large.
    pub uncertain: usize,
    /// Number of pixels left out because the lens has no ray for them.
    pub unseen: usize,
    /// Number of pixels left out because they are between the surfaces at a depth edge.
    pub flying: usize,
    /// Number of pixels that share a voxel with an earlier one: kept pixels minus points.
    pub merged: usize,
}

impl ColoredCloud {
    /// Back-projects a depth map of any size, seen by the camera of the upright image `rgb`. `deviations` are the standard
    /// deviations of the depths in metres, in a map of the same size. A pixel that is left out for several reasons is
    /// counted as uncertain, else as flying.
    pub fn new(
        depth: &DepthMap,
        deviations: Option<&DepthMap>,
        rgb: &RgbImage,
        camera: &Camera,
        options: &CloudOptions,
    ) -> Self {
        let (width, height) = (depth.width(), depth.height());
        let camera = camera.stretched((width, height));
        let image_size = (rgb.width() as usize, rgb.height() as usize);
        let mut cloud = Self::default();
        let flying = (!options.keep_flying).then(|| {
            let [fx, fy, ..] = camera.intrinsics();
            flying_pixels(depth, [fx, fy])
        });
        for point in depth.points() {
            let sigma = deviations.and_then(|map| map.get(point.x, point.y));
            if sigma.is_some_and(|sigma| options.limits.exclude(point.depth, sigma)) {
                cloud.uncertain += 1;
                continue;
            }
            let pixel = point.y * width + point.x;
            if flying.as_ref().is_some_and(|flying| flying[pixel]) {
                cloud.flying += 1;
                continue;
            }
            let pixel = [point.x as f64, point.y as f64];
            let Some(position) = camera.unproject(pixel, f64::from(point.depth)) else {
                cloud.unseen += 1;
                continue;
            };
            let color = rgb.get_pixel(
                (point.x * image_size.0 / width) as u32,
                (point.y * image_size.1 / height) as u32,
            );
            cloud.points.push(ColoredPoint {
                position,
                color: color.0,
                sigma,
            });
        }
        if let Some(size) = options.voxel {
            let before = cloud.points.len();
            cloud.points = thinned(&cloud.points, size);
            cloud.merged = before - cloud.points.len();
        }
        cloud
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall at 1 m beside one at 2 m, with a ramp of two pixels between them.
    fn cloud(options: CloudOptions) -> ColoredCloud {
        let row = [1.0, 1.0, 1.0, 1.0, 1.25, 1.6, 2.0, 2.0, 2.0, 2.0];
        let values: Vec<f32> = (0..60).map(|i| row[i % 10]).collect();
        let depth = DepthMap::new(10, 6, values).unwrap();
        let sigma = DepthMap::new(10, 6, vec![0.1; 60]).unwrap();
        let rgb = RgbImage::from_pixel(10, 6, image::Rgb([9, 8, 7]));
        let camera = Camera::pinhole([100.0, 100.0], [0.0, 0.0]);
        ColoredCloud::new(&depth, Some(&sigma), &rgb, &camera, &options)
    }

    #[test]
    fn what_is_left_out_is_counted() {
        let all = CloudOptions {
            keep_flying: true,
            ..CloudOptions::default()
        };
        assert_eq!(cloud(all).points.len(), 60);
        let default_cloud = cloud(CloudOptions::default());
        assert_eq!((default_cloud.points.len(), default_cloud.flying), (48, 12));
        assert!(
            default_cloud
                .points
                .iter()
                .all(|point| [1.0, 2.0].contains(&point.position[2]))
        );
        let sure = cloud(CloudOptions {
            limits: DeviationLimits {
                absolute: Some(0.05),
                relative: None,
            },
            ..CloudOptions::default()
        });
        assert_eq!((sure.points.len(), sure.uncertain, sure.flying), (0, 60, 0));
        // 0.1 m is a tenth of the depth of the near wall, and a twentieth of the far one.
        let far = cloud(CloudOptions {
            limits: DeviationLimits {
                absolute: None,
                relative: Some(0.099),
            },
            keep_flying: true,
            ..CloudOptions::default()
        });
        assert_eq!((far.points.len(), far.uncertain), (36, 24));
        // The near wall is 3 cm wide, the far one 6 cm and 10 cm high.
        let thin = cloud(CloudOptions {
            voxel: Some(0.5),
            ..CloudOptions::default()
        });
        assert_eq!((thin.points.len(), thin.merged, thin.flying), (2, 46, 12));
        assert_eq!(thin.points[0].color, [9, 8, 7]);
    }
}
