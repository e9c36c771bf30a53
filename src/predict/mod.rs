//! Image and sparse depths to dense depth: `lsdc-core`'s completer on any device, and methods without
//! training, by name.

mod encoder;
mod method;
mod preserve;
mod weights;

use encoder::encoder_on;
pub(crate) use encoder::{adapted_blocks, first_adapted};
pub use lsdc_classic::Classic;
pub use lsdc_weights::{Embedded, embedded, encoder_of};
pub use method::{Method, complete_classic};
pub use preserve::Preserve;
pub use weights::{are_none, open_weights, weights_fit, weights_hash, weights_name};

use crate::data::DepthMap;
use crate::error::{Error, Result};
use crate::model::{NormKind, OnDevice, load};
use burn::tensor::Device;
use image::RgbImage;
use lsdc_core::{Channels, Completer, Completion, DepthGuide, Image, Observations, Scene, Weights};
use std::path::Path;
use std::sync::Arc;

/// Opens weights from a file, or those that come with the program, on a device; `none` is no network at all.
///
/// # Errors
/// A file that cannot be read or is no weights file.
pub fn open_completer(weights: Option<&Path>, device: &Device) -> Result<Completer> {
    if are_none(weights) {
        return Ok(Completer::without_network(weights_fit(weights)?)?);
    }
    completer(&open_weights(weights)?, device)
}

/// Weights with the fit that they were trained for: prepared for the CPU where that is possible, on
/// burn's tensors elsewhere.
///
/// # Errors
/// Weights that do not belong to their network.
pub fn completer(weights: &Weights, device: &Device) -> Result<Completer> {
    let network = &weights.network;
    let prepared = network.norm == NormKind::Batch && !network.hidden.is_empty();
    if *device == Device::flex() && prepared {
        let builder = Completer::builder(weights);
        return Ok(match encoder_of(network)? {
            None => builder,
            Some(encoder) => builder.encoder(encoder),
        }
        .build()?);
    }
    plain_completer(weights, device)
}

/// The same with the network as it was trained: the plain reference of the prepared one.
///
/// # Errors
/// Weights that do not belong to their network.
pub fn plain_completer(weights: &Weights, device: &Device) -> Result<Completer> {
    let encoder = encoder_on(&weights.network, device)?;
    let network = OnDevice::new(load(weights, device)?, encoder, device)?;
    Ok(Completer::builder(weights)
        .network(Arc::new(network))
        .build()?)
}

/// What the network says of an image.
///
/// # Errors
/// An image without pixels.
pub fn scene(completer: &Completer, rgb: &RgbImage) -> Result<Scene> {
    guided_scene(completer, rgb, None)
}

/// The same beside a guide, if there is one.
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

/// Completes the measurements of a map under the guidance of an image of its size.
///
/// # Errors
/// Image and sparse depths of different sizes, or no point.
pub fn complete(completer: &Completer, rgb: &RgbImage, sparse: &DepthMap) -> Result<Completion> {
    check_sizes(rgb, sparse)?;
    Ok(scene(completer, rgb)?.complete(&Observations::from_map(sparse))?)
}

/// Whether image and sparse depths show the same pixels.
///
/// # Errors
/// They differ in size.
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
