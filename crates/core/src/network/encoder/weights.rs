//! The weights of an encoder, for any device.

use super::{EncoderConfig, PATCH};
use crate::error::{Error, WeightsError};
use crate::network::tensors::Tensors;
use crate::tensor::Tensor;
use lsdc_kernels::simd::Level;
use std::collections::BTreeMap;

/// Gain and shift of a layer normalisation.
pub type NormWeights<'a> = (&'a [f32], &'a [f32]);

/// A linear layer of tokens.
#[derive(Clone, Copy, Debug)]
pub struct TokenLayer<'a> {
    /// `[outputs, inputs]`
    pub weights: &'a [f32],
    /// One for each output.
    pub bias: &'a [f32],
    /// What each output is multiplied by, with its bias; 1 if there is none.
    pub scale: Option<&'a [f32]>,
}

impl TokenLayer<'_> {
    /// The number of inputs.
    pub fn depth(&self) -> usize {
        self.weights.len() / self.bias.len().max(1)
    }
}

/// The weights of a block.
#[derive(Clone, Copy, Debug)]
pub struct BlockWeights<'a> {
    /// Before attention, and before the perceptron.
    pub norms: [NormWeights<'a>; 2],
    /// Queries, keys and values; the projection of the outputs of all heads; both layers of the perceptron.
    pub layers: [TokenLayer<'a>; 4],
}

/// The weights of an encoder, whose shapes have been checked.
#[derive(Clone, Debug)]
pub struct EncoderWeights<'a> {
    /// The embedding of patches: weights `[width, 3, PATCH, PATCH]` and bias.
    pub patch_embedding: (&'a [f32], &'a [f32]),
    /// `[width]`
    pub class_token: &'a [f32],
    /// `[side x side, width]`, and before it that of the class token.
    pub positions: &'a [f32],
    /// In their order.
    pub blocks: Vec<BlockWeights<'a>>,
    /// Of the features.
    pub norm: NormWeights<'a>,
}

impl<'a> EncoderWeights<'a> {
    /// The weights among tensors by the names that `DINOv2` gives them.
    ///
    /// # Errors
    /// Sizes that make no encoder, and tensors that are missing, superfluous or of the wrong shape.
    pub fn new(
        config: &EncoderConfig,
        tensors: &'a BTreeMap<String, Tensor>,
    ) -> Result<Self, Error> {
        config.check()?;
        let tensors = Tensors::new(tensors, Level::here());
        let (width, hidden) = (config.width, config.hidden);
        let vector = |name: &str, length: usize| tensors.values(name, &[length]);
        let norm = |name: &str| -> Result<NormWeights<'a>, WeightsError> {
            let gain = vector(&format!("{name}.weight"), width)?;
            Ok((gain, vector(&format!("{name}.bias"), width)?))
        };
        let layer = |name: &str, (depth, columns): (usize, usize), scale: Option<&str>| {
            Ok::<_, WeightsError>(TokenLayer {
                weights: tensors.values(&format!("{name}.weight"), &[columns, depth])?,
                bias: vector(&format!("{name}.bias"), columns)?,
                scale: scale.map(|scale| vector(scale, columns)).transpose()?,
            })
        };
        let block = |i: usize| {
            let name = |part: &str| format!("blocks.{i}.{part}");
            let scales = ["ls1.gamma", "ls2.gamma"].map(name);
            Ok::<_, WeightsError>(BlockWeights {
                norms: [norm(&name("norm1"))?, norm(&name("norm2"))?],
                layers: [
                    layer(&name("attn.qkv"), (width, 3 * width), None)?,
                    layer(&name("attn.proj"), (width, width), Some(&scales[0]))?,
                    layer(&name("mlp.fc1"), (width, hidden), None)?,
                    layer(&name("mlp.fc2"), (hidden, width), Some(&scales[1]))?,
                ],
            })
        };
        let count = 1 + config.side * config.side;
        let weights = Self {
            patch_embedding: (
                tensors.values("patch_embed.proj.weight", &[width, 3, PATCH, PATCH])?,
                vector("patch_embed.proj.bias", width)?,
            ),
            class_token: tensors.values("cls_token", &[1, 1, width])?,
            positions: tensors.values("pos_embed", &[1, count, width])?,
            blocks: (0..config.blocks).map(block).collect::<Result<_, _>>()?,
            norm: norm("norm")?,
        };
        // It replaces masked patches in training.
        tensors.ignore("mask_token");
        tensors.check_all_used()?;
        Ok(weights)
    }
}
