//! The sizes of a pretrained encoder.

use crate::error::WeightsError;

/// Side of a patch in pixels.
pub const PATCH: usize = 14;
/// Added to the variance in layer normalisation.
pub const LAYER_EPSILON: f32 = 1e-6;

/// The sizes of an encoder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EncoderConfig {
    /// Channels of a token.
    pub width: usize,
    /// Number of attention heads, which divides the channels.
    pub heads: usize,
    /// Number of blocks.
    pub blocks: usize,
    /// Channels between the two layers of the MLP.
    pub hidden: usize,
    /// Side, in patches, of the images for which the position embeddings were trained.
    pub side: usize,
    /// Indices, from 0, of the blocks whose tokens are features.
    pub taps: Vec<usize>,
}

impl EncoderConfig {
    /// ViT-S/14, as in `DINOv2` and Depth Anything V2 Small: 22,056,576 parameters.
    pub fn small() -> Self {
        Self {
            width: 384,
            heads: 6,
            blocks: 12,
            hidden: 1536,
            side: 37,
            taps: vec![2, 5, 8, 11],
        }
    }

    /// Total number of channels of all taps.
    pub fn channels(&self) -> usize {
        self.taps.len() * self.width
    }

    pub(super) fn check(&self) -> Result<(), WeightsError> {
        let fine = self.heads > 0
            && self.width > 0
            && self.width.is_multiple_of(self.heads)
            && self.side > 0
            && self.hidden > 0
            && !self.taps.is_empty()
            && self.taps.is_sorted()
            && self.taps.iter().all(|tap| *tap < self.blocks);
        if fine {
            Ok(())
        } else {
            Err(WeightsError::Unsupported("an encoder of such sizes"))
        }
    }
}
