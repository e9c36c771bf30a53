//! Depth Anything V2 (Yang et al. 2024): relative inverse depth predicted from the image alone, as a guide.

use crate::depth_guide::DepthGuide;
use crate::error::{Result, SettingsError};
use crate::image::Image;
use crate::network::{DepthHead, Encoder, EncoderConfig, PATCH};
use crate::resize::resized_colours_cubic;
use crate::scene::normalised;
use crate::tensor::Tensor;
use crate::weights::Normalisation;
use lsdc_kernels::simd::Level;
use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::sync::Arc;

/// The published network Depth Anything V2 Small, which predicts relative inverse depth from an image alone.
///
/// Its weights are not part of this crate. Cheap to clone, and can be shared between threads.
///
/// ```no_run
/// use lsdc_core::settings::FitConfig;
/// use lsdc_core::weights::Tensor;
/// use lsdc_core::{Channels, Completer, DepthAnything, Image};
/// use std::collections::BTreeMap;
///
/// # fn main() -> lsdc_core::Result<()> {
/// # let (encoder, head) = (BTreeMap::<String, Tensor>::new(), BTreeMap::<String, Tensor>::new());
/// // The tensors of the published file by their names; `lsdc_weights::depth_anything` reads the installed ones.
/// let network = DepthAnything::new(&encoder, &head)?;
/// # let (width, height) = (64, 48);
/// # let rgb = vec![128_u8; 3 * width * height];
/// let image = Image::new(width, height, Channels::Rgb, &rgb)?;
/// let guide = network.predict(&image, DepthAnything::SHORT_SIDE)?;
///
/// let completer = Completer::without_network(FitConfig::default())?;
/// let scene = completer.guided_scene(&image, &guide)?;
/// # Ok(())
/// # }
/// ```
#[derive(Clone)]
pub struct DepthAnything(Arc<Inner>);

struct Inner {
    encoder: Arc<Encoder>,
    head: Arc<DepthHead>,
}

impl std::fmt::Debug for DepthAnything {
    /// Omits the weights, of which there are millions.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("DepthAnything")
            .field("encoder", self.0.encoder.config())
            .finish_non_exhaustive()
    }
}

/// Largest aspect ratio of the network's input.
const MOST_ASPECT: usize = 8;

impl DepthAnything {
    /// The default shorter side of the network's input, in pixels: images of 4:3 are then as large as the input of the weights
    /// `anything`.
    pub const SHORT_SIDE: usize = 336;
    /// The shorter sides that can be used; the published network was trained at the largest.
    pub const SHORT_SIDES: RangeInclusive<usize> = 252..=518;

    /// Prepares the network from the tensors of its encoder by their names in `DINOv2` (`blocks.0.attn.qkv.weight`), and from
    /// the tensors of its head by their published names (`depth_head.projects.0.weight`).
    ///
    /// # Errors
    /// Tensors that are missing, superfluous or of the wrong shape.
    pub fn new(
        encoder: &BTreeMap<String, Tensor>,
        head: &BTreeMap<String, Tensor>,
    ) -> Result<Self> {
        let level = Level::here();
        let encoder = Encoder::new(EncoderConfig::small(), encoder, level)?;
        Self::with_parts(Arc::new(encoder), DepthHead::new(head, level)?)
    }

    /// Combines an encoder and a head that are already prepared.
    ///
    /// # Errors
    /// The head does not match the taps of the encoder.
    #[doc(hidden)]
    pub fn with_parts(encoder: Arc<Encoder>, head: DepthHead) -> Result<Self> {
        head.check(encoder.config())?;
        let head = Arc::new(head);
        Ok(Self(Arc::new(Inner { encoder, head })))
    }

    /// The depth head, for scenes whose network reads the same encoder (see
    /// [`Completer::with_depth_head`](crate::Completer::with_depth_head)).
    #[doc(hidden)]
    pub fn depth_head(&self) -> Arc<DepthHead> {
        self.0.head.clone()
    }

    /// Predicts the relative inverse depth of an upright image, as a guide of its completion. The image is resized to
    /// multiples of 14 pixels, its shorter side to about `short_side`, one of [`Self::SHORT_SIDES`].
    ///
    /// # Errors
    /// A short side out of range, colours that are not finite, or a constant prediction, as for an image of one colour.
    pub fn predict(&self, image: &Image<'_>, short_side: usize) -> Result<DepthGuide> {
        let (values, (height, width)) = self.inverse_depth(image, short_side)?;
        DepthGuide::with_sky(width, height, &values)
    }

    /// The values of [`Self::predict`], and their height and width.
    ///
    /// # Errors
    /// As for [`Self::predict`].
    #[doc(hidden)]
    pub fn inverse_depth(
        &self,
        image: &Image<'_>,
        short_side: usize,
    ) -> Result<(Vec<f32>, (usize, usize))> {
        Self::check_short_side(short_side)?;
        let size = (image.height(), image.width());
        let (rows, columns) = patches(size, short_side);
        let input = (rows * PATCH, columns * PATCH);
        let colours = resized_colours_cubic(&image.rgb()?, size, input)?;
        // The statistics of ImageNet, as in the published network.
        let Normalisation {
            mean, deviation, ..
        } = Normalisation::default();
        let values = normalised(&colours, mean, deviation);
        let Inner { encoder, head } = &*self.0;
        let features = encoder.features(&values, input)?;
        Ok((head.predict(&features)?, input))
    }

    /// Checks that a short side is in range.
    pub(crate) fn check_short_side(short_side: usize) -> Result<(), SettingsError> {
        if Self::SHORT_SIDES.contains(&short_side) {
            return Ok(());
        }
        let (least, most) = (Self::SHORT_SIDES.start(), Self::SHORT_SIDES.end());
        let what = format!(
            "the short side of the image that the encoder reads is {short_side}, not {least} to {most} pixels"
        );
        Err(SettingsError::new(what))
    }

    /// Frees cached memory.
    pub fn release(&self) {
        self.0.encoder.release();
        self.0.head.release();
    }
}

/// Returns rows and columns of patches to which an image of this height and width is resized.
fn patches((height, width): (usize, usize), short_side: usize) -> (usize, usize) {
    let shorter = height.min(width).max(1) as f64;
    let count = |length: usize| {
        let pixels = length as f64 / shorter * short_side as f64;
        (pixels / PATCH as f64).round() as usize
    };
    let most = MOST_ASPECT * count(height.min(width).max(1));
    (count(height).clamp(1, most), count(width).clamp(1, most))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sides_are_whole_patches_and_keep_the_aspect() {
        for (size, short_side, expected) in [
            ((480, 640), 336, (24, 32)),
            ((640, 480), 336, (32, 24)),
            ((352, 1216), 252, (18, 62)),
            ((14, 14), 518, (37, 37)),
            // Rounded as in the published code: 518 / 14 and 518 * 1216 / 352 / 14.
            ((352, 1216), 518, (37, 128)),
            ((1, 100_000), 336, (24, 8 * 24)),
        ] {
            assert_eq!(patches(size, short_side), expected, "{size:?}");
        }
    }
}
