//! The sizes of a pretrained encoder.

use crate::error::WeightsError;

/// Pixels of a side of a patch.
pub const PATCH: usize = 14;
/// What layer normalisation adds to variances.
pub const LAYER_EPSILON: f32 = 1e-6;

/// The sizes of an encoder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EncoderConfig {
    /// Channels of a token.
    pub width: usize,
    /// Heads of attention, which divide the channels.
    pub heads: usize,
    /// Number of blocks.
    pub blocks: usize,
    /// Channels between the two layers of a perceptron.
    pub hidden: usize,
    /// Patches of a side of the images that positions were learned for.
    pub side: usize,
    /// The blocks, from 0, whose tokens are features.
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

    /// Channels of all taps together.
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
