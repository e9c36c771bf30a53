//! Attention and perceptrons, and the last blocks of an encoder alone, through which adapters learn.

use crate::model::adapters::{Adapter, Adapters};
use burn::module::Module;
use burn::tensor::activation::{gelu, softmax};
use burn::tensor::{Device, Tensor, TensorData, s};
use lsdc_core::WeightsError;
use lsdc_core::network::{EncoderConfig, LAYER_EPSILON, MORE_BLOCKS};
use lsdc_core::weights::Tensor as Table;
use std::collections::BTreeMap;

/// The last blocks of a vision transformer, and the normalisation after them.
#[derive(Module, Debug)]
pub struct LastBlocks {
    /// The first of them, from 0.
    #[module(skip)]
    first: usize,
    /// The blocks of the encoder whose tokens are features.
    #[module(skip)]
    taps: Vec<usize>,
    #[module(skip)]
    heads: usize,
    blocks: Vec<Block>,
    last: Norm,
}

#[derive(Module, Debug)]
struct Block {
    norms: [Norm; 2],
    queries: Affine,
    mixed: Affine,
    first: Affine,
    second: Affine,
    /// What attention and perceptron are multiplied by before they are added.
    scales: [Tensor<3>; 2],
}

/// A linear map with bias.
#[derive(Module, Debug)]
pub(super) struct Affine {
    weight: Tensor<3>,
    bias: Tensor<3>,
}

/// A layer normalisation.
#[derive(Module, Debug)]
struct Norm {
    gain: Tensor<3>,
    shift: Tensor<3>,
}

/// Tensors by name, to be put on a device.
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

    fn norm(&self, name: &str, width: usize) -> Result<Norm, WeightsError> {
        Ok(Norm {
            gain: self.row(&format!("{name}.weight"), width)?,
            shift: self.row(&format!("{name}.bias"), width)?,
        })
    }

    /// A map of `from` values to `to`, whose weights are stored as `shape`, the outputs first.
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
    fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        let centred = x.clone() - x.mean_dim(2);
        let variance = centred.clone().square().mean_dim(2);
        let deviation = (variance + f64::from(LAYER_EPSILON)).sqrt();
        centred / deviation * self.gain.clone() + self.shift.clone()
    }
}

impl Block {
    fn new(
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

    /// Tokens `[images, tokens, width]` after attention, changed by an adapter if there is one, and the perceptron.
    fn forward(&self, tokens: Tensor<3>, heads: usize, adapter: Option<&Adapter>) -> Tensor<3> {
        let attended = self.attend(tokens.clone(), heads, adapter);
        let tokens = tokens + self.mixed.forward(attended) * self.scales[0].clone();
        let inner = self.first.forward(self.norms[1].forward(tokens.clone()));
        tokens + self.second.forward(gelu(inner)) * self.scales[1].clone()
    }

    fn attend(&self, tokens: Tensor<3>, heads: usize, adapter: Option<&Adapter>) -> Tensor<3> {
        let [images, count, width] = tokens.dims();
        let depth = width / heads;
        let tokens = self.norms[0].forward(tokens);
        let rows = self.queries.forward(tokens.clone());
        // Queries, keys and values `[images, heads, tokens, depth]`.
        let [queries, keys, values] = [0, 1, 2].map(|which| {
            let part = rows
                .clone()
                .slice(s![.., .., which * width..(which + 1) * width]);
            let change = adapter.and_then(|adapter| match which {
                0 => Some(&adapter.queries),
                2 => Some(&adapter.values),
                _ => None,
            });
            let part = match change {
                None => part,
                Some(change) => {
                    let rows = tokens.clone().reshape([images * count, width]);
                    part + change.forward(rows).reshape([images, count, width])
                }
            };
            let part: Tensor<4> = part.reshape([images, count, heads, depth]);
            part.swap_dims(1, 2)
        });
        let likeness = queries.matmul(keys.swap_dims(2, 3)) / (depth as f64).sqrt();
        let answers: Tensor<4> = softmax(likeness, 3).matmul(values);
        answers.swap_dims(1, 2).reshape([images, count, width])
    }
}

impl LastBlocks {
    /// The last `count` blocks of an encoder from tensors by the names that `DINOv2` gives them, on a device.
    ///
    /// # Errors
    /// More blocks than there are, and tensors that are missing or of the wrong shape.
    pub fn new(
        config: &EncoderConfig,
        count: usize,
        tensors: &BTreeMap<String, Table>,
        device: &Device,
    ) -> Result<Self, WeightsError> {
        let source = TensorSource { tensors, device };
        let Some(first) = config.blocks.checked_sub(count) else {
            return Err(WeightsError::Unsupported(MORE_BLOCKS));
        };
        let blocks = (first..config.blocks).map(|index| Block::new(config, index, &source));
        Ok(Self {
            first,
            taps: config.taps.clone(),
            heads: config.heads,
            blocks: blocks.collect::<Result<_, _>>()?,
            last: source.norm("norm", config.width)?,
        })
    }

    /// The first of them, from 0.
    pub fn first(&self) -> usize {
        self.first
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.blocks.len()
    }

    /// From the tokens that enter the first of them, `[images, 1 + patches, width]`, the features of the taps among them
    /// `[images, patches, channels]`.
    pub(super) fn forward(
        &self,
        mut tokens: Tensor<3>,
        adapters: Option<&Adapters>,
    ) -> Vec<Tensor<3>> {
        let adapters = adapters.map_or(&[][..], |adapters| &adapters.blocks);
        // Those of the last blocks.
        let before = self.blocks.len().saturating_sub(adapters.len());
        let adapters = std::iter::repeat_n(None, before).chain(adapters.iter().map(Some));
        let mut taps = Vec::new();
        for ((index, block), adapter) in (self.first..).zip(&self.blocks).zip(adapters) {
            tokens = block.forward(tokens, self.heads, adapter);
            if self.taps.contains(&index) {
                taps.push(self.last.forward(tokens.clone().slice(s![.., 1..])));
            }
        }
        taps
    }

    /// Features `[images, rows, columns, channels]` of the encoder alone, with those of these blocks replaced by what
    /// they say with adapters to the tokens that enter the first of them, `[images, 1 + rows x columns, width]`.
    pub fn features(
        &self,
        encoded: Tensor<4>,
        tokens: Tensor<3>,
        adapters: &Adapters,
    ) -> Tensor<4> {
        let [images, rows, columns, channels] = encoded.dims();
        let new = Tensor::cat(self.forward(tokens, Some(adapters)), 2);
        let unchanged = channels - new.dims()[2];
        let new = new.reshape([images, rows, columns, channels - unchanged]);
        if unchanged == 0 {
            return new;
        }
        Tensor::cat(vec![encoded.slice(s![.., .., .., ..unchanged]), new], 3)
    }
}
