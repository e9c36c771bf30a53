//! A vision transformer (Dosovitskiy et al. 2021) as a pretrained encoder, as in `DINOv2` (Oquab et al. 2023) and Depth
//! Anything V2 (Yang et al. 2024), prepared for the CPU.
//!
//! An image is divided into patches; each becomes a token, in addition to the class token. Every block adds attention to the
//! tokens, then the output of an MLP. The normalised tokens after some of the blocks are the features.

mod block;
mod config;
mod depth_head;
#[cfg(test)]
mod depth_head_tests;
mod feature_map;
mod position;
mod weights;

use crate::error::{Error, FitError};
use crate::tensor::Tensor;
use block::{Block, tokens_per_task};
pub use config::{EncoderConfig, LAYER_EPSILON, PATCH};
pub use depth_head::{DEPTH_HEAD, DepthHead, HeadLayers};
pub use feature_map::{EncoderSide, FeatureMap, in_patches};
use lsdc_kernels::attention::layer_norm;
use lsdc_kernels::simd::{Level, Packed, Scratch, Tail};
pub use position::positions;
use rayon::prelude::*;
use std::collections::BTreeMap;
pub use weights::{BlockWeights, EncoderWeights, NormWeights, TokenLayer};

/// An encoder, prepared for one instruction set.
#[derive(Debug)]
pub struct Encoder {
    config: EncoderConfig,
    level: Level,
    patch_embedding: Packed,
    class_token: Vec<f32>,
    /// Position embeddings `[side x side, width]`, preceded by that of the class token.
    positions: Vec<f32>,
    blocks: Vec<Block>,
    /// Gain and shift of the final normalisation.
    norm: (Vec<f32>, Vec<f32>),
    scratch: Scratch,
}

/// The features of an image: for each tap `[rows, columns, width]`.
#[derive(Clone, Debug)]
pub struct Features {
    /// Patches across.
    pub columns: usize,
    /// Patches down.
    pub rows: usize,
    /// Features after each of the blocks that are taps.
    pub taps: Vec<Vec<f32>>,
}

impl Features {
    /// Separates concatenated taps, `[rows, columns, channels]`, as in a [`FeatureMap`].
    pub(in crate::network) fn separated(
        values: &[f32],
        (rows, columns): (usize, usize),
        taps: usize,
    ) -> Self {
        let width = values.len() / (rows * columns * taps).max(1);
        let tap = |i: usize| {
            let patches = values.chunks_exact((taps * width).max(1));
            let own = patches.flat_map(|patch| &patch[i * width..][..width]);
            own.copied().collect()
        };
        Self {
            columns,
            rows,
            taps: (0..taps).map(tap).collect(),
        }
    }
}

impl Encoder {
    /// Prepares an encoder from tensors by their names in `DINOv2`.
    ///
    /// # Errors
    /// Invalid sizes, and tensors that are missing, superfluous or of the wrong shape.
    pub fn new(
        config: EncoderConfig,
        tensors: &BTreeMap<String, Tensor>,
        level: Level,
    ) -> Result<Self, Error> {
        let weights = EncoderWeights::new(&config, tensors)?;
        let (width, depth) = (config.width, 3 * PATCH * PATCH);
        let (kernel, bias) = weights.patch_embedding;
        let blocks = weights.blocks.iter();
        let blocks = blocks.map(|block| Block::new(level, config.heads, block));
        Ok(Self {
            level,
            patch_embedding: Packed::new(level, (depth, width), bias, |row, column| {
                // Rows are (y, x, channel), as images are stored.
                let (pixel, channel) = (row / 3, row % 3);
                kernel[(column * 3 + channel) * PATCH * PATCH + pixel]
            }),
            class_token: weights.class_token.to_vec(),
            positions: weights.positions.to_vec(),
            blocks: blocks.collect(),
            norm: (weights.norm.0.to_vec(), weights.norm.1.to_vec()),
            scratch: Scratch::default(),
            config,
        })
    }

    /// The sizes.
    pub fn config(&self) -> &EncoderConfig {
        &self.config
    }

    /// Computes the features of a normalised image `[height, width, 3]`.
    ///
    /// # Errors
    /// The height or width is not a multiple of [`PATCH`], or the number of values does not match.
    pub fn features(&self, image: &[f32], size: (usize, usize)) -> Result<Features, FitError> {
        let (rows, columns) = patches_of(image, size)?;
        let channels = self.config.width;
        // Run on a thread of the pool, to avoid waiting for the pool at each step.
        Ok(rayon::scope(|_| {
            let mut tokens = self.tokens(image, (rows, columns));
            let mut queries_keys_values = vec![0.0; 3 * tokens.len()];
            let mut attended = vec![0.0; tokens.len()];
            let scratch = &self.scratch;
            let mut taps = Vec::new();
            for (i, block) in self.blocks.iter().enumerate() {
                block.attend(&tokens, &mut queries_keys_values, &mut attended, scratch);
                block.transform(&attended, &mut tokens, scratch);
                if self.config.taps.contains(&i) {
                    let mut tap = vec![0.0; tokens.len() - channels];
                    let norm = (&self.norm.0[..], &self.norm.1[..]);
                    let part = tokens_per_task(tokens.len() / channels) * channels;
                    let parts = tap.par_chunks_mut(part);
                    let tokens = tokens[channels..].par_chunks(part);
                    parts
                        .zip(tokens)
                        .for_each(|(tap, x)| layer_norm(self.level, x, norm, LAYER_EPSILON, tap));
                    taps.push(tap);
                }
            }
            Features {
                columns,
                rows,
                taps,
            }
        }))
    }

    /// Frees cached memory.
    pub fn release(&self) {
        self.scratch.clear();
    }

    /// Returns the class token and the tokens of the patches, with their position embeddings.
    fn tokens(&self, image: &[f32], size: (usize, usize)) -> Vec<f32> {
        let channels = self.config.width;
        let mut tokens = positions(&self.positions, self.config.side, channels, size);
        let class = tokens[..channels].iter_mut().zip(&self.class_token);
        class.for_each(|(token, value)| *token += value);
        let (row, depth) = (3 * PATCH * size.1, 3 * PATCH * PATCH);
        let rows = tokens[channels..].par_chunks_mut(size.1 * channels);
        rows.enumerate().for_each(|(y, tokens)| {
            self.scratch.with(size.1 * depth + tokens.len(), |memory| {
                let (patches, output) = memory.split_at_mut(size.1 * depth);
                for (x, patch) in patches.chunks_exact_mut(depth).enumerate() {
                    for (i, line) in patch.chunks_exact_mut(3 * PATCH).enumerate() {
                        let from = (y * PATCH + i) * row + x * 3 * PATCH;
                        line.copy_from_slice(&image[from..][..3 * PATCH]);
                    }
                }
                let skip = Some(&*tokens);
                self.patch_embedding
                    .apply(patches, Tail { skip, relu: false }, output);
                tokens.copy_from_slice(output);
            });
        });
        tokens
    }
}

/// Returns the number of patches down and across a normalised image `[height, width, 3]`.
fn patches_of(image: &[f32], (height, width): (usize, usize)) -> Result<(usize, usize), FitError> {
    let whole = |length: usize| length > 0 && length.is_multiple_of(PATCH);
    if whole(height) && whole(width) && image.len() == 3 * height * width {
        return Ok((height / PATCH, width / PATCH));
    }
    Err(FitError::Shape(format!(
        "{} values are no image of {width}x{height} pixels whose sides are multiples of {PATCH}",
        image.len()
    )))
}

#[cfg(test)]
mod tests;
