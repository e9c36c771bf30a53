//! A colour image with its depth.

use super::DepthMap;
use image::RgbImage;
use lsdc_files::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// The name of a frame: unique in its dataset, stable between machines.
pub type FrameId = String;

/// Rejects a name that would place files outside of their folder.
///
/// # Errors
/// An absolute or empty name, or one with `..` or a backslash.
pub fn check_name(name: &str) -> Result<()> {
    // `C:` is a path of its own on Windows.
    let drive = |part: &str| part.as_bytes().get(1) == Some(&b':');
    let plain = |part: &str| !matches!(part, "" | "." | "..") && !drive(part);
    if name.split('/').all(plain) && !name.contains(['\\', '\0']) {
        return Ok(());
    }
    Err(
        Error::config(format!("`{name}` cannot be the name of a frame"))
            .hint("names are paths below a folder, without `..` and backslashes"),
    )
}

/// Whether a frame was taken indoors or outdoors; some protocols treat them differently.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Environment {
    /// In a building.
    #[default]
    Indoor,
    /// In the open.
    Outdoor,
}

/// The training target of a frame, if it is not the depth of the frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Target {
    /// Depth in metres along the optical axis, as large as the frame.
    pub depth: DepthMap,
    /// Weight of the error at each pixel, from 0 to 1, row by row.
    pub weights: Vec<f32>,
}

/// A colour image and the depth of the same pixels.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Name of the frame.
    pub id: FrameId,
    /// 8-bit sRGB image.
    pub rgb: RgbImage,
    /// Depth in metres along the optical axis, as large as `rgb`.
    pub depth: DepthMap,
    /// Sparse depths provided by the dataset, if any, as large as `rgb`.
    pub sparse: Option<DepthMap>,
    /// Validity mask provided by the dataset, if any, row by row.
    pub mask: Option<Vec<bool>>,
    /// For laser scans, whose returns are all in `sparse`: the scanner ring of each pixel, row by row; -1 where there is no
    /// return or the ring is unknown. Points are drawn from the returns, and given returns are not scored.
    pub rings: Option<Vec<i32>>,
    /// Whether the frame was taken indoors or outdoors.
    pub place: Environment,
    /// Training target, if a teacher provides one.
    pub target: Option<Target>,
}

impl Frame {
    /// Creates an indoor frame without sparse depths or mask.
    ///
    /// # Errors
    /// Image and depth of different sizes.
    pub fn new(id: FrameId, rgb: RgbImage, depth: DepthMap) -> Result<Self> {
        let frame = Self {
            id,
            rgb,
            depth,
            sparse: None,
            mask: None,
            rings: None,
            place: Environment::default(),
            target: None,
        };
        frame.check_size("depth map", frame.depth.width(), frame.depth.height())?;
        Ok(frame)
    }

    /// Adds the sparse depths provided by the dataset.
    ///
    /// # Errors
    /// The sizes of depths and image differ.
    pub fn with_sparse(mut self, sparse: DepthMap) -> Result<Self> {
        self.check_size("sparse depth map", sparse.width(), sparse.height())?;
        self.sparse = Some(sparse);
        Ok(self)
    }

    /// Adds the validity mask provided by the dataset: `height` rows of `width`.
    ///
    /// # Errors
    /// The sizes of mask and image differ.
    pub fn with_mask(mut self, width: usize, height: usize, mask: Vec<bool>) -> Result<Self> {
        self.check_size("validity mask", width, height)?;
        self.mask = Some(mask);
        Ok(self)
    }

    /// Makes the frame a laser scan: its sparse depths are the returns, and `rings` has the ring of each pixel.
    ///
    /// # Errors
    /// No sparse depths, or not one ring for each pixel.
    pub fn with_rings(mut self, rings: Vec<i32>) -> Result<Self> {
        if self.sparse.is_none() || rings.len() != self.depth.values().len() {
            return Err(Error::shape(format!(
                "frame `{}`: {} rings for {}x{} pixels",
                self.id,
                rings.len(),
                self.depth.width(),
                self.depth.height()
            )));
        }
        self.rings = Some(rings);
        Ok(self)
    }

    /// Returns whether the depths are isolated points rather than surfaces: the returns of a laser scan, or depths at fewer
    /// than half of the pixels.
    pub fn is_sparse(&self) -> bool {
        self.rings.is_some() || 2 * self.depth.count() < self.depth.values().len()
    }

    fn check_size(&self, what: &str, width: usize, height: usize) -> Result<()> {
        let image = (self.rgb.width() as usize, self.rgb.height() as usize);
        if image == (width, height) {
            return Ok(());
        }
        Err(Error::shape(format!(
            "frame `{}`: the {what} is {width}x{height} but the image is {}x{}",
            self.id, image.0, image.1
        )))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depths_at_fewer_than_half_of_the_pixels_are_sparse() {
        let frame = |measured: usize| {
            let values = (0..8).map(|i| f32::from(u8::from(i < measured))).collect();
            let depth = DepthMap::new(4, 2, values).unwrap();
            Frame::new("a".into(), RgbImage::new(4, 2), depth).unwrap()
        };
        assert!(frame(3).is_sparse() && !frame(4).is_sparse());
        let scan = frame(8);
        let sparse = scan.depth.clone();
        let scan = scan.with_sparse(sparse).unwrap();
        assert!(scan.with_rings(vec![-1; 8]).unwrap().is_sparse());
    }

    #[test]
    fn names_stay_below_their_folder() {
        for name in ["a", "scene/00001", "a..b/.c", "12:30", "ä b#1"] {
            assert!(check_name(name).is_ok(), "{name}");
        }
        for name in [
            "",
            "/etc/a",
            "../a",
            "a/../../b",
            "a/..",
            "a//b",
            "./a",
            "a\\b",
            "C:/a",
            "C:",
        ] {
            assert!(check_name(name).is_err(), "{name}");
        }
    }
}
