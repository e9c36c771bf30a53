//! The known depths of an image at their places, and as maps of one depth to a pixel.

use crate::error::Result;
use crate::grid::nearest_pixels;
use crate::{DepthMap, Unit};
use lsdc_core::cloud::{fronts, is_behind};
use lsdc_core::{Observation, Observations};

/// Known depths of an image, and how they were read.
#[derive(Clone, Debug)]
pub struct Sparse {
    /// Depths in metres (or in the unit of a model) at their places in the upright image.
    pub points: Observations,
    /// The identities of the points, if they are of a model, in which other images see them too.
    pub ids: Option<Vec<u64>>,
    /// Width and height of the upright image.
    pub size: (usize, usize),
    /// The unit of the file.
    pub unit: Unit,
    /// `true` if the unit was inferred.
    pub guessed: bool,
    /// Points without a positive and finite depth.
    pub ignored: usize,
    /// Points outside the image.
    pub outside: usize,
    /// Points behind a nearer surface in the same pixel, and those of a cloud that nearer ones
    /// surround.
    pub hidden: usize,
    /// What was assumed or left out and should be checked, a sentence each.
    pub remarks: Vec<String>,
}

impl Sparse {
    /// One depth to a pixel, for methods that know no places between them: that of the nearest point,
    /// and of several on the nearest surface their mean, weighted by their precision. A point between
    /// pixels counts for each of them.
    ///
    /// # Errors
    /// An image without pixels.
    pub fn map(&self) -> Result<DepthMap> {
        self.maps().map(|(depth, _)| depth)
    }

    /// As [`Self::map`], and the standard deviations of the means, if all points have one.
    ///
    /// # Errors
    /// An image without pixels.
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
