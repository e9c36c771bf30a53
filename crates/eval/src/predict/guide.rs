//! Guides of frames: predictions read from files, or by Depth Anything V2 Small.

use crate::data::{DepthMap, GuideSource};
use image::RgbImage;
use lsdc_core::{Channels, DepthAnything, DepthGuide, Image};
use lsdc_files::error::{Error, Result};
use lsdc_weights::{InstalledDepthAnything, ResizeLayer, depth_anything};
use serde_json::{Value, json};
use std::fmt::{Display, Formatter};
use std::str::FromStr;

/// Name of the network that predicts guides.
pub const DEPTH_ANYTHING: &str = "depth-anything";

/// Name of the option without a guide.
const NO_GUIDE: &str = "none";

/// The choice of `--guide`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum GuideSpec {
    /// No guide, not even the default one of weights on an encoder.
    None,
    /// Predictions of another program, in files.
    Files(GuideSource),
    /// Predictions of Depth Anything V2 Small.
    DepthAnything(MonocularSpec),
}

/// Settings of Depth Anything V2 Small by `--guide` and `--head`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MonocularSpec {
    /// Approximate shorter side, in pixels, of the image as read by the network.
    pub short_side: usize,
    /// Layer of the depth head that has a replacement.
    pub layer: ResizeLayer,
}

impl GuideSpec {
    /// Returns the choice with a depth head, if `--head` names one.
    ///
    /// # Errors
    /// A head is given for predictions in files.
    pub fn with_head(self, head: Option<ResizeLayer>) -> Result<Self> {
        match (self, head) {
            (spec, None) => Ok(spec),
            (Self::None, Some(_)) => Err(Error::config("`--head` is for a guide, not for none")
                .hint(format!("give --guide {DEPTH_ANYTHING}, or leave it out"))),
            (Self::DepthAnything(spec), Some(layer)) => {
                Ok(Self::DepthAnything(MonocularSpec { layer, ..spec }))
            }
            (Self::Files(_), Some(_)) => Err(Error::config(format!(
                "`--head` is for the guide {DEPTH_ANYTHING}, not for predictions in files"
            ))
            .hint(format!("give --guide {DEPTH_ANYTHING}, or leave it out"))),
        }
    }
}

impl FromStr for GuideSpec {
    type Err = Error;

    /// Parses `none`, `depth-anything`, `depth-anything:SIDE`, or the syntax of [`GuideSource`].
    fn from_str(text: &str) -> Result<Self> {
        if text == NO_GUIDE {
            return Ok(Self::None);
        }
        let (name, side) = match text.split_once(':') {
            Some((name, side)) => (name, Some(side)),
            None => (text, None),
        };
        if name != DEPTH_ANYTHING {
            return text.parse().map(Self::Files);
        }
        let spec = |short_side: usize| {
            Self::DepthAnything(MonocularSpec {
                short_side,
                layer: ResizeLayer::default(),
            })
        };
        let Some(side) = side else {
            return Ok(spec(DepthAnything::SHORT_SIDE));
        };
        let sides = DepthAnything::SHORT_SIDES;
        let parsed = side.parse().ok();
        let parsed = parsed.filter(|side: &usize| sides.contains(side));
        parsed.map(spec).ok_or_else(|| {
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
            Self::None => f.write_str(NO_GUIDE),
            Self::Files(source) => source.fmt(f),
            Self::DepthAnything(spec) => spec.fmt(f),
        }
    }
}

impl Display for MonocularSpec {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        write!(f, "{DEPTH_ANYTHING}:{}", self.short_side)?;
        match self.layer {
            ResizeLayer::Learned => Ok(()),
            ResizeLayer::Published => f.write_str(", published head"),
        }
    }
}

/// Depth Anything V2 Small, loaded for predicting guides.
#[derive(Clone, Debug)]
pub struct MonocularGuide {
    spec: MonocularSpec,
    installed: InstalledDepthAnything,
}

impl MonocularGuide {
    /// Loads the network from the user's data folder, if `guide` names it.
    ///
    /// # Errors
    /// The network is not installed, lacks its depth head or the requested tensor, or its files are damaged.
    pub fn open(guide: Option<&GuideSpec>) -> Result<Option<Self>> {
        let Some(&GuideSpec::DepthAnything(spec)) = guide else {
            return Ok(None);
        };
        let installed = depth_anything(spec.layer)?;
        Ok(Some(Self { spec, installed }))
    }

    /// Returns the settings.
    pub fn spec(&self) -> MonocularSpec {
        self.spec
    }

    /// Predicts the guide of an upright image.
    ///
    /// # Errors
    /// An image without pixels, or a constant prediction.
    pub fn predict(&self, rgb: &RgbImage) -> Result<DepthGuide> {
        let (width, height) = (rgb.width() as usize, rgb.height() as usize);
        let image = Image::new(width, height, Channels::Rgb, rgb.as_raw())?;
        let guide = self.installed.network.predict(&image, self.spec.short_side);
        guide.map_err(|e| Error::of_core(e, DEPTH_ANYTHING))
    }

    /// Returns the relative inverse depth of an upright image, as large as the network's output; 0 at infinity.
    ///
    /// # Errors
    /// An image without pixels.
    pub fn inverse_depth(&self, rgb: &RgbImage) -> Result<DepthMap> {
        let (width, height) = (rgb.width() as usize, rgb.height() as usize);
        let image = Image::new(width, height, Channels::Rgb, rgb.as_raw())?;
        let network = &self.installed.network;
        let (values, (height, width)) = network.inverse_depth(&image, self.spec.short_side)?;
        Ok(DepthMap::new(width, height, values)?)
    }

    /// Returns the hash of the weights of the network.
    pub fn hash(&self) -> &str {
        &self.installed.hash
    }

    /// Returns a record of the inputs of the guides, apart from the images.
    pub fn made_from(&self) -> Value {
        json!([self.spec.to_string(), self.installed.hash])
    }

    /// Frees the memory cached for further images.
    pub fn release(&self) {
        self.installed.network.release();
    }
}

impl Display for MonocularGuide {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}, {}", self.spec, self.installed.hash)
    }
}

/// Source of the guides of several frames.
#[derive(Clone, Copy, Debug)]
pub enum Guides<'a> {
    /// A folder of files named by frames, each for the frame after the protocol.
    Files(&'a GuideSource),
    /// Predictions by the network for the frames after the protocol.
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
            let expected = MonocularSpec {
                short_side: side,
                layer: ResizeLayer::Learned,
            };
            assert_eq!(spec, GuideSpec::DepthAnything(expected));
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
        assert_eq!(parsed("none").unwrap(), GuideSpec::None);
        assert_eq!(GuideSpec::None.to_string(), "none");
        for text in ["./none", "./depth-anything", "depth-anything.npy:disparity"] {
            assert!(matches!(parsed(text), Ok(GuideSpec::Files(_))), "{text}");
        }
    }
    #[test]
    fn a_head_is_of_the_network_alone() {
        let network: GuideSpec = "depth-anything:252".parse().unwrap();
        assert_eq!(network.clone().with_head(None).unwrap(), network);
        let learned = network.clone().with_head(Some(ResizeLayer::Learned));
        assert_eq!(learned.unwrap(), network);
        let published = network.with_head(Some(ResizeLayer::Published)).unwrap();
        assert_eq!(published.to_string(), "depth-anything:252, published head");

        let files: GuideSpec = "guide.npy:disparity".parse().unwrap();
        assert_eq!(files.clone().with_head(None).unwrap(), files);
        let error = files.with_head(Some(ResizeLayer::Learned)).unwrap_err();
        assert!(error.to_string().contains("`--head`"), "{error}");
        assert!(error.advice().unwrap().contains("--guide depth-anything"));
    }
}
