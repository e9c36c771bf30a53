//! Depth completion of an image and sparse depths: the completer of `lsdc-core`, and methods without training by name.

mod guide;
mod method;
mod preserve;

pub use guide::{DEPTH_ANYTHING, GuideSpec, Guides, MonocularGuide, MonocularSpec};
pub use lsdc_classic::Classic;
pub use method::{Method, SystemKind, complete_classic};
pub use preserve::Preserve;

use crate::data::DepthMap;
use image::RgbImage;
use lsdc_core::{Channels, Completer, Completion, DepthGuide, Image, Observations, Scene};
use lsdc_files::error::{Error, Result};
use std::fmt::Debug;

/// Computes the features and basis functions of an image, ready for a fit.
///
/// # Errors
/// An image without pixels.
pub fn scene(completer: &Completer, rgb: &RgbImage) -> Result<Scene> {
    guided_scene(completer, rgb, None)
}

/// Does the same with a guide, if there is one.
///
/// # Errors
/// An image without pixels.
pub fn guided_scene(
    completer: &Completer,
    rgb: &RgbImage,
    guide: Option<&DepthGuide>,
) -> Result<Scene> {
    let (width, height) = (rgb.width() as usize, rgb.height() as usize);
    let image = Image::new(width, height, Channels::Rgb, rgb.as_raw())?;
    Ok(match guide {
        None => completer.scene(&image)?,
        Some(guide) => completer.guided_scene(&image, guide)?,
    })
}

/// Completes a sparse depth map, guided by an image of the same size.
///
/// # Errors
/// Image and sparse depths of different sizes, or no point.
pub fn complete(completer: &Completer, rgb: &RgbImage, sparse: &DepthMap) -> Result<Completion> {
    check_sizes(rgb, sparse)?;
    Ok(scene(completer, rgb)?.complete(&Observations::from_map(sparse))?)
}

/// A method that completes a sparse depth map, guided by an image of the same size.
pub trait DepthCompleter: Debug + Send + Sync {
    /// Returns the depth of every pixel.
    ///
    /// # Errors
    /// Image and sparse depths of different sizes, or no point.
    fn depth(&self, rgb: &RgbImage, sparse: &DepthMap) -> Result<DepthMap>;
}

impl DepthCompleter for Completer {
    fn depth(&self, rgb: &RgbImage, sparse: &DepthMap) -> Result<DepthMap> {
        Ok(complete(self, rgb, sparse)?.depth()?)
    }
}

/// Checks that image and sparse depths have the same size.
///
/// # Errors
/// The sizes differ.
pub fn check_sizes(rgb: &RgbImage, sparse: &DepthMap) -> Result<()> {
    if (rgb.width() as usize, rgb.height() as usize) == (sparse.width(), sparse.height()) {
        return Ok(());
    }
    Err(Error::shape(format!(
        "the image is {}x{} (width x height) but the sparse depths are {}x{}",
        rgb.width(),
        rgb.height(),
        sparse.width(),
        sparse.height()
    ))
    .hint(
        "both must show the same pixels; move the points to the image's size, do not interpolate",
    ))
}
