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
    /// One value for each output.
    pub bias: &'a [f32],
    /// Factor of each output and its bias; `None` for 1.
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
    /// Normalisations before attention, and before the MLP.
    pub norms: [NormWeights<'a>; 2],
    /// Queries, keys and values; output projection; both layers of the MLP.
    pub layers: [TokenLayer<'a>; 4],
}

/// The weights of an encoder, with validated shapes.
#[derive(Clone, Debug)]
pub struct EncoderWeights<'a> {
    /// Patch embedding: weights `[width, 3, PATCH, PATCH]` and bias.
    pub patch_embedding: (&'a [f32], &'a [f32]),
    /// `[width]`
    pub class_token: &'a [f32],
    /// Position embeddings `[side x side, width]`, preceded by that of the class token.
    pub positions: &'a [f32],
    /// Blocks in order.
    pub blocks: Vec<BlockWeights<'a>>,
    /// Final normalisation of the features.
    pub norm: NormWeights<'a>,
}

impl<'a> EncoderWeights<'a> {
    /// Collects the weights from tensors by their names in `DINOv2`.
    ///
    /// # Errors
    /// Invalid sizes, and tensors that are missing, superfluous or of the wrong shape.
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
        // Only used for masked patches in training.
        tensors.ignore("mask_token");
        tensors.check_all_used()?;
        Ok(weights)
    }
}
