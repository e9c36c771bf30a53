//! A colour image and what is known of its depth.

use super::DepthMap;
use image::RgbImage;
use lsdc_files::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// The name of a frame: unique in its dataset, stable between machines.
pub type FrameId = String;

/// Refuses a name that leads out of the folder below which files are named so.
///
/// # Errors
/// An absolute name, one with `..` or a backslash, or none.
pub fn check_name(name: &str) -> Result<()> {
    // `C:` is a folder of its own on Windows.
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

/// Where a frame was taken; some protocols treat the two differently.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Environment {
    /// In a room.
    #[default]
    Indoor,
    /// Under the sky.
    Outdoor,
}

/// What a network is to find in a frame, where that is not its depth.
#[derive(Clone, Debug, PartialEq)]
pub struct Target {
    /// Metres along the optical axis, as large as the frame.
    pub depth: DepthMap,
    /// How much an error at each pixel counts, from 0 to 1, row by row.
    pub weights: Vec<f32>,
}

/// A colour image and the depth of the same pixels.
#[derive(Clone, Debug)]
pub struct Frame {
    /// The frame's name.
    pub id: FrameId,
    /// 8-bit sRGB.
    pub rgb: RgbImage,
    /// Metres along the optical axis, as large as `rgb`.
    pub depth: DepthMap,
    /// The sparse depths that come with the dataset, if any, as large as `rgb`.
    pub sparse: Option<DepthMap>,
    /// Which depths the dataset declares valid, if it does, row by row.
    pub mask: Option<Vec<bool>>,
    /// Of a laser scan, whose returns are all in `sparse`: the scanner's ring that saw each pixel, row by row; -1 where
    /// there is no return or its ring is unknown. Points are drawn from the returns, and those that are given are not
    /// scored.
    pub rings: Option<Vec<i32>>,
    /// Where the frame was taken.
    pub place: Environment,
    /// What is to be learned from the frame, if a teacher has seen it.
    pub target: Option<Target>,
}

impl Frame {
    /// A frame without points or mask of its own, taken in a room.
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

    /// Adds the sparse depths that come with the dataset.
    ///
    /// # Errors
    /// They are not as large as the image.
    pub fn with_sparse(mut self, sparse: DepthMap) -> Result<Self> {
        self.check_size("sparse depth map", sparse.width(), sparse.height())?;
        self.sparse = Some(sparse);
        Ok(self)
    }

    /// Adds the dataset's validity mask of `height` rows of `width`.
    ///
    /// # Errors
    /// It is not as large as the image.
    pub fn with_mask(mut self, width: usize, height: usize, mask: Vec<bool>) -> Result<Self> {
        self.check_size("validity mask", width, height)?;
        self.mask = Some(mask);
        Ok(self)
    }

    /// Makes the frame a laser scan: its sparse depths are the returns, seen by these rings.
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

    /// Whether its depths are those of single points and not of surfaces: the returns of a laser scan, or depths at fewer
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
