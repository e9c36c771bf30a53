//! The known depths of an image at subpixel positions, and as maps of one depth per pixel.

use crate::error::Result;
use crate::grid::nearest_pixels;
use crate::{DepthMap, Unit};
use lsdc_core::cloud::{fronts, is_behind};
use lsdc_core::{Observation, Observations};

/// Known depths of an image, and how they were read.
#[derive(Clone, Debug)]
pub struct Sparse {
    /// Depths in metres (or in the unit of a model) at positions in the upright image.
    pub points: Observations,
    /// Identifiers of the points, if they are of a model, so that other images share them.
    pub ids: Option<Vec<u64>>,
    /// Width and height of the upright image.
    pub size: (usize, usize),
    /// The unit of the file.
    pub unit: Unit,
    /// Whether the unit was inferred.
    pub guessed: bool,
    /// Number of points without a positive and finite depth.
    pub ignored: usize,
    /// Number of points outside the image.
    pub outside: usize,
    /// Number of points that nearer ones hide: in the same pixel, around points of clouds, and beside points of scans.
    pub hidden: usize,
    /// Assumptions and omissions that should be checked, a sentence each.
    pub remarks: Vec<String>,
}

impl Sparse {
    /// Returns one depth per pixel, for methods without subpixel positions: the nearest point's, or the mean of several
    /// points on the nearest surface, weighted by their precision. A point between pixels counts for each of them.
    ///
    /// # Errors
    /// The image has no pixels.
    pub fn map(&self) -> Result<DepthMap> {
        self.maps().map(|(depth, _)| depth)
    }

    /// Returns [`Self::map`], and the standard deviations of the means if all points have one.
    ///
    /// # Errors
    /// The image has no pixels.
    pub fn maps(&self) -> Result<(DepthMap, Option<DepthMap>)> {
        let (width, height) = self.size;
        let area = width * height;
        let pixels = || {
            let each = |point: &Observation| nearest_pixels([point.u, point.v], self.size);
            let points = self.points.iter();
            points.flat_map(move |point| each(point).map(move |pixel| (pixel, point)))
        };
        let fronts = fronts(pixels(), area);
        let weighted = !self.points.is_empty() && self.points.iter().all(|p| p.sigma.is_some());
        // Sums of weights, and of weighted depths.
        let mut sums = vec![[0.0_f64; 2]; area];
        for (pixel, point) in pixels() {
            if !is_behind(point, fronts[pixel]) {
                let sigma = point.sigma.filter(|_| weighted).map_or(1.0, f64::from);
                let weight = sigma.powi(-2);
                sums[pixel][0] += weight;
                sums[pixel][1] += weight * f64::from(point.depth);
            }
        }
        let map = |value: &dyn Fn(&[f64; 2]) -> f64| {
            let value = |sum: &[f64; 2]| if sum[0] > 0.0 { value(sum) as f32 } else { 0.0 };
            DepthMap::new(width, height, sums.iter().map(value).collect())
        };
        let depth = map(&|sum| sum[1] / sum[0])?;
        let sigma = weighted.then(|| map(&|sum| sum[0].sqrt().recip()));
        Ok((depth, sigma.transpose()?))
    }
}
