//! Guides of frames: predictions in files, or those of Depth Anything V2 Small.

use crate::data::GuideSource;
use image::RgbImage;
use lsdc_core::{Channels, DepthAnything, DepthGuide, Image};
use lsdc_files::error::{Error, Result};
use lsdc_weights::{InstalledDepthAnything, ResizeLayer, depth_anything};
use serde_json::{Value, json};
use std::fmt::{Display, Formatter};
use std::str::FromStr;

/// The name of the network that predicts guides.
const DEPTH_ANYTHING: &str = "depth-anything";

/// What `--guide` names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum GuideSpec {
    /// Predictions of other programs, in files.
    Files(GuideSource),
    /// Predictions of Depth Anything V2 Small, which reads an image with a shorter side of about so many pixels.
    DepthAnything(usize),
}

impl FromStr for GuideSpec {
    type Err = Error;

    /// `depth-anything`, `depth-anything:SIDE`, or what [`GuideSource`] reads.
    fn from_str(text: &str) -> Result<Self> {
        let (name, side) = match text.split_once(':') {
            Some((name, side)) => (name, Some(side)),
            None => (text, None),
        };
        if name != DEPTH_ANYTHING {
            return text.parse().map(Self::Files);
        }
        let Some(side) = side else {
            return Ok(Self::DepthAnything(DepthAnything::SHORT_SIDE));
        };
        let sides = DepthAnything::SHORT_SIDES;
        let parsed = side.parse().ok();
        let parsed = parsed.filter(|side: &usize| sides.contains(side));
        parsed.map(Self::DepthAnything).ok_or_else(|| {
            let (least, most) = (sides.start(), sides.end());
            Error::config(format!("`{side}` is no short side of an image for {name}")).hint(format!(
                "from {least} to {most} pixels, as in {name}:{}; a file of this name is ./{name}",
                DepthAnything::SHORT_SIDE
            ))
        })
    }
}

impl Display for GuideSpec {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Files(source) => source.fmt(f),
            Self::DepthAnything(short_side) => write!(f, "{DEPTH_ANYTHING}:{short_side}"),
        }
    }
}

/// Depth Anything V2 Small, ready to predict guides.
#[derive(Clone, Debug)]
pub struct MonocularGuide {
    installed: InstalledDepthAnything,
    short_side: usize,
}

impl MonocularGuide {
    /// Reads the network from the user's data folder.
    ///
    /// # Errors
    /// It is not installed, or without its depth head, or its files are damaged.
    pub fn open(short_side: usize) -> Result<Self> {
        Ok(Self {
            installed: depth_anything(ResizeLayer::default())?,
            short_side,
        })
    }

    /// The guide of an upright image.
    ///
    /// # Errors
    /// An image without pixels, or a prediction that is the same everywhere.
    pub fn predict(&self, rgb: &RgbImage) -> Result<DepthGuide> {
        let (width, height) = (rgb.width() as usize, rgb.height() as usize);
        let image = Image::new(width, height, Channels::Rgb, rgb.as_raw())?;
        let guide = self.installed.network.predict(&image, self.short_side);
        guide.map_err(|e| Error::of_core(e, DEPTH_ANYTHING))
    }

    /// What the guides depend on, beside the images.
    pub fn made_from(&self) -> Value {
        json!([DEPTH_ANYTHING, self.short_side, self.installed.hash])
    }

    /// Frees the memory that is kept for further images.
    pub fn release(&self) {
        self.installed.network.release();
    }
}

impl Display for MonocularGuide {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        let Self {
            installed,
            short_side,
        } = self;
        write!(f, "{DEPTH_ANYTHING}:{short_side}, {}", installed.hash)
    }
}

/// Where the guides of several frames come from.
#[derive(Clone, Copy, Debug)]
pub enum Guides<'a> {
    /// A folder of files by the names of frames, each of the frame after the protocol.
    Files(&'a GuideSource),
    /// Predictions for the frames after the protocol.
    Predicted(&'a MonocularGuide),
}

impl Display for Guides<'_> {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Files(source) => source.fmt(f),
            Self::Predicted(network) => network.fmt(f),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_network_is_named_with_or_without_a_size() {
        let parsed = |text: &str| text.parse::<GuideSpec>();
        for (text, side) in [("depth-anything", 336), ("depth-anything:518", 518)] {
            let spec = parsed(text).unwrap();
            assert_eq!(spec, GuideSpec::DepthAnything(side));
            assert_eq!(parsed(&spec.to_string()).unwrap(), spec);
        }
        for text in [
            "depth-anything:251",
            "depth-anything:519",
            "depth-anything:disparity",
            "depth-anything:",
        ] {
            let error = parsed(text).unwrap_err();
            assert!(error.advice().unwrap().contains("252 to 518"), "{text}");
        }
        for text in ["./depth-anything", "depth-anything.npy:disparity"] {
            assert!(matches!(parsed(text), Ok(GuideSpec::Files(_))), "{text}");
        }
    }
}
