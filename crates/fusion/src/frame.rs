//! A depth map with its camera and optional data.

use crate::error::{Error, Result};
use lsdc_core::{Camera, DepthMap, Image};

/// A depth map with its camera, and optionally its standard deviations and colours.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    /// Depths along the optical axis; 0 = no measurement.
    pub depth: &'a DepthMap,
    /// The standard deviation of each depth, row by row, in the unit of the depths. A pixel whose standard deviation is not
    /// positive and finite is skipped.
    pub deviation: Option<&'a [f32]>,
    /// The camera of the depth map at its pose in the world.
    pub camera: &'a Camera,
    /// Colours, at the size of the depth map.
    pub image: Option<&'a Image<'a>>,
}

impl Frame<'_> {
    /// Returns width and height.
    pub(crate) fn size(&self) -> (usize, usize) {
        (self.depth.width(), self.depth.height())
    }

    pub(crate) fn check(&self) -> Result<()> {
        self.camera.check().map_err(lsdc_core::Error::from)?;
        let depth = self.size();
        let differs = |other, found| Error::Sizes {
            depth,
            other,
            found,
        };
        if let Some(deviation) = self.deviation
            && deviation.len() != depth.0 * depth.1
        {
            return Err(differs("standard deviations", (deviation.len(), 1)));
        }
        match self.image.map(|image| (image.width(), image.height())) {
            Some(found) if found != depth => Err(differs("image", found)),
            _ => Ok(()),
        }
    }
}
