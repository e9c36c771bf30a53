//! Blocks of a vision transformer: attention and MLP.

use burn::tensor::activation::{gelu, softmax};
use burn::tensor::{Device, Tensor, TensorData, s};
use lsdc_core::WeightsError;
use lsdc_core::network::{EncoderConfig, LAYER_EPSILON};
use lsdc_core::weights::Tensor as Table;
use std::collections::BTreeMap;

/// Attention, then an MLP.
#[derive(Clone, Debug)]
pub(super) struct Block {
    norms: [Norm; 2],
    queries: Affine,
    mixed: Affine,
    first: Affine,
    second: Affine,
    /// Factors of the outputs of attention and MLP before they are added.
    scales: [Tensor<3>; 2],
}

/// A linear map with bias.
#[derive(Clone, Debug)]
pub(super) struct Affine {
    weight: Tensor<3>,
    bias: Tensor<3>,
}

/// A layer normalisation.
#[derive(Clone, Debug)]
pub(super) struct Norm {
    gain: Tensor<3>,
    shift: Tensor<3>,
}

/// Tensors by name, and the device to place them on.
pub(super) struct TensorSource<'a> {
    pub(super) tensors: &'a BTreeMap<String, Table>,
    pub(super) device: &'a Device,
}

impl TensorSource<'_> {
    pub(super) fn values(&self, name: &str, shape: &[usize]) -> Result<&[f32], WeightsError> {
        let wrong = |reason: String| WeightsError::Tensor {
            name: name.to_owned(),
            reason,
        };
        let table = self
            .tensors
            .get(name)
            .ok_or_else(|| wrong("is missing".into()))?;
        if table.shape() == shape {
            Ok(table.values())
        } else {
            let found = table.shape();
            Err(wrong(format!("has shape {found:?}, expected {shape:?}")))
        }
    }

    pub(super) fn tensor(&self, values: Vec<f32>, shape: [usize; 3]) -> Tensor<3> {
        Tensor::from_data(TensorData::new(values, shape), self.device)
    }

    fn row(&self, name: &str, width: usize) -> Result<Tensor<3>, WeightsError> {
        let values = self.values(name, &[width])?.to_vec();
        Ok(self.tensor(values, [1, 1, width]))
    }

    pub(super) fn norm(&self, name: &str, width: usize) -> Result<Norm, WeightsError> {
        Ok(Norm {
            gain: self.row(&format!("{name}.weight"), width)?,
            shift: self.row(&format!("{name}.bias"), width)?,
        })
    }

    /// Reads a linear map of `from` values to `to`; `shape` is the shape of its stored weights, outputs first.
    pub(super) fn affine(
        &self,
        name: &str,
        (from, to): (usize, usize),
        shape: &[usize],
    ) -> Result<Affine, WeightsError> {
        let values = self.values(&format!("{name}.weight"), shape)?.to_vec();
        Ok(Affine {
            weight: self.tensor(values, [1, to, from]).swap_dims(1, 2),
            bias: self.row(&format!("{name}.bias"), to)?,
        })
    }
}

impl Affine {
    pub(super) fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        x.matmul(self.weight.clone()) + self.bias.clone()
    }
}

impl Norm {
    pub(super) fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        let centred = x.clone() - x.mean_dim(2);
        let variance = centred.clone().square().mean_dim(2);
        let deviation = (variance + f64::from(LAYER_EPSILON)).sqrt();
        centred / deviation * self.gain.clone() + self.shift.clone()
    }
}

impl Block {
    pub(super) fn new(
        config: &EncoderConfig,
        index: usize,
        source: &TensorSource<'_>,
    ) -> Result<Self, WeightsError> {
        let (width, hidden) = (config.width, config.hidden);
        let name = |part: &str| format!("blocks.{index}.{part}");
        let norm = |part: &str| source.norm(&name(part), width);
        let affine = |part: &str, from: usize, to: usize| {
            source.affine(&name(part), (from, to), &[to, from])
        };
        let scale = |part: &str| source.row(&name(part), width);
        Ok(Self {
            norms: [norm("norm1")?, norm("norm2")?],
            queries: affine("attn.qkv", width, 3 * width)?,
            mixed: affine("attn.proj", width, width)?,
            first: affine("mlp.fc1", width, hidden)?,
            second: affine("mlp.fc2", hidden, width)?,
            scales: [scale("ls1.gamma")?, scale("ls2.gamma")?],
        })
    }

    /// Applies attention and the MLP to tokens `[images, tokens, width]`.
    pub(super) fn forward(&self, tokens: Tensor<3>, heads: usize) -> Tensor<3> {
        let attended = self.attend(tokens.clone(), heads);
        let tokens = tokens + self.mixed.forward(attended) * self.scales[0].clone();
        let inner = self.first.forward(self.norms[1].forward(tokens.clone()));
        tokens + self.second.forward(gelu(inner)) * self.scales[1].clone()
    }

    fn attend(&self, tokens: Tensor<3>, heads: usize) -> Tensor<3> {
        let [images, count, width] = tokens.dims();
        let depth = width / heads;
        let rows = self.queries.forward(self.norms[0].forward(tokens));
        // Queries, keys and values `[images, heads, tokens, depth]`.
        let [queries, keys, values] = [0, 1, 2].map(|which| {
            let part = rows
                .clone()
                .slice(s![.., .., which * width..(which + 1) * width]);
            let part: Tensor<4> = part.reshape([images, count, heads, depth]);
            part.swap_dims(1, 2)
        });
        let likeness = queries.matmul(keys.swap_dims(2, 3)) / (depth as f64).sqrt();
        let answers: Tensor<4> = softmax(likeness, 3).matmul(values);
        answers.swap_dims(1, 2).reshape([images, count, width])
    }
}
