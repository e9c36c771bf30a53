//! The pretrained encoder on burn's tensors, differentiable, for devices other than the CPU.

mod blocks;
#[cfg(test)]
mod tests;

use blocks::{Affine, Block, Norm, TensorSource};
use burn::tensor::{Device, Tensor, TensorData, s};
use lsdc_core::WeightsError;
use lsdc_core::network::{EncoderConfig, PATCH, positions};
use lsdc_core::weights::Tensor as Table;
use std::collections::BTreeMap;

/// A vision transformer on any device; computes the same as [`lsdc_core::network::Encoder`].
#[derive(Clone, Debug)]
pub struct VisionTransformer {
    config: EncoderConfig,
    patches: Affine,
    class_token: Tensor<3>,
    /// Position embeddings `[1 + side x side, width]`; interpolated on the host.
    positions: Vec<f32>,
    blocks: Vec<Block>,
    /// Final normalisation of features.
    norm: Norm,
}

impl VisionTransformer {
    /// Loads an encoder onto a device, from tensors named as in `DINOv2`.
    ///
    /// # Errors
    /// A tensor is missing or has the wrong shape.
    pub fn new(
        config: EncoderConfig,
        tensors: &BTreeMap<String, Table>,
        device: &Device,
    ) -> Result<Self, WeightsError> {
        let source = TensorSource { tensors, device };
        let width = config.width;
        let count = 1 + config.side * config.side;
        let blocks = (0..config.blocks).map(|index| Block::new(&config, index, &source));
        Ok(Self {
            patches: source.affine(
                "patch_embed.proj",
                (3 * PATCH * PATCH, width),
                &[width, 3, PATCH, PATCH],
            )?,
            class_token: {
                let values = source.values("cls_token", &[1, 1, width])?.to_vec();
                source.tensor(values, [1, 1, width])
            },
            positions: source.values("pos_embed", &[1, count, width])?.to_vec(),
            blocks: blocks.collect::<Result<_, _>>()?,
            norm: source.norm("norm", width)?,
            config,
        })
    }

    /// Computes the features of normalised images `[images, height, width, 3]`, whose sides are multiples of [`PATCH`]: all
    /// taps concatenated, `[images, rows, columns, channels]`.
    pub fn forward(&self, images: Tensor<4>) -> Tensor<4> {
        let [count, height, width, _] = images.dims();
        let (rows, columns) = (height / PATCH, width / PATCH);
        let cut: Tensor<6> = images.reshape([count, rows, PATCH, columns, PATCH, 3]);
        let patches: Tensor<3> =
            cut.permute([0, 1, 3, 5, 2, 4])
                .reshape([count, rows * columns, 3 * PATCH * PATCH]);
        let class_token = self.class_token.clone().repeat_dim(0, count);
        let tokens = Tensor::cat(vec![class_token, self.patches.forward(patches)], 1);
        let mut tokens = tokens + self.places((rows, columns));
        let mut taps = Vec::new();
        for (index, block) in self.blocks.iter().enumerate() {
            tokens = block.forward(tokens, self.config.heads);
            if self.config.taps.contains(&index) {
                taps.push(self.norm.forward(tokens.clone().slice(s![.., 1..])));
            }
        }
        let features: Tensor<3> = Tensor::cat(taps, 2);
        features.reshape([count, rows, columns, self.config.channels()])
    }

    /// Returns the position embeddings of all tokens.
    fn places(&self, size: (usize, usize)) -> Tensor<3> {
        let EncoderConfig { width, side, .. } = self.config;
        let values = positions(&self.positions, side, width, size);
        let shape = [1, values.len() / width, width];
        Tensor::from_data(TensorData::new(values, shape), &self.class_token.device())
    }
}
