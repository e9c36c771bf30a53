//! The pretrained encoder on burn's tensors: for devices other than the CPU, and differentiable.

use super::Table;
use burn::tensor::activation::{gelu, softmax};
use burn::tensor::{Device, Tensor, TensorData, s};
use lsdc_core::WeightsError;
use lsdc_core::network::{EncoderConfig, LAYER_EPSILON, PATCH, positions};
use std::collections::BTreeMap;

/// A vision transformer, as [`lsdc_core::network::Encoder`] computes it, on any device.
#[derive(Clone, Debug)]
pub struct VisionTransformer {
    config: EncoderConfig,
    patches: Affine,
    whole: Tensor<3>,
    /// `[1 + side x side, width]`; interpolated on the host.
    positions: Vec<f32>,
    blocks: Vec<Block>,
    last: Norm,
}

#[derive(Clone, Debug)]
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
#[derive(Clone, Debug)]
struct Affine {
    weight: Tensor<3>,
    bias: Tensor<3>,
}

/// A layer normalisation.
#[derive(Clone, Debug)]
struct Norm {
    gain: Tensor<3>,
    shift: Tensor<3>,
}

/// Tensors by name, to be put on a device.
struct Source<'a> {
    tensors: &'a BTreeMap<String, Table>,
    device: &'a Device,
}

impl Source<'_> {
    fn values(&self, name: &str, shape: &[usize]) -> Result<&[f32], WeightsError> {
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

    fn tensor(&self, values: Vec<f32>, shape: [usize; 3]) -> Tensor<3> {
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
    fn affine(
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
    fn forward(&self, x: Tensor<3>) -> Tensor<3> {
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
        source: &Source<'_>,
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

    /// Tokens `[images, tokens, width]` after attention and the perceptron.
    fn forward(&self, tokens: Tensor<3>, heads: usize) -> Tensor<3> {
        let answers = self.mixed.forward(self.attend(tokens.clone(), heads));
        let tokens = tokens + answers * self.scales[0].clone();
        let inner = self.first.forward(self.norms[1].forward(tokens.clone()));
        tokens + self.second.forward(gelu(inner)) * self.scales[1].clone()
    }

    fn attend(&self, tokens: Tensor<3>, heads: usize) -> Tensor<3> {
        let [images, count, width] = tokens.dims();
        let depth = width / heads;
        let rows = self.queries.forward(self.norms[0].forward(tokens));
        // Queries, keys and values `[images, heads, tokens, depth]`.
        let rows: Tensor<5> = rows.reshape([images, count, 3, heads, depth]);
        let [queries, keys, values] = [0, 1, 2].map(|which| {
            let part = rows.clone().slice(s![.., .., which..which + 1]);
            part.reshape([images, count, heads, depth]).swap_dims(1, 2)
        });
        let likeness = queries.matmul(keys.swap_dims(2, 3)) / (depth as f64).sqrt();
        let answers: Tensor<4> = softmax(likeness, 3).matmul(values);
        answers.swap_dims(1, 2).reshape([images, count, width])
    }
}

impl VisionTransformer {
    /// An encoder from tensors by the names that `DINOv2` gives them, on a device.
    ///
    /// # Errors
    /// Tensors that are missing or of the wrong shape.
    pub fn new(
        config: EncoderConfig,
        tensors: &BTreeMap<String, Table>,
        device: &Device,
    ) -> Result<Self, WeightsError> {
        let source = Source { tensors, device };
        let width = config.width;
        let count = 1 + config.side * config.side;
        let blocks = (0..config.blocks).map(|index| Block::new(&config, index, &source));
        Ok(Self {
            patches: source.affine(
                "patch_embed.proj",
                (3 * PATCH * PATCH, width),
                &[width, 3, PATCH, PATCH],
            )?,
            whole: {
                let values = source.values("cls_token", &[1, 1, width])?.to_vec();
                source.tensor(values, [1, 1, width])
            },
            positions: source.values("pos_embed", &[1, count, width])?.to_vec(),
            blocks: blocks.collect::<Result<_, _>>()?,
            last: source.norm("norm", width)?,
            config,
        })
    }

    /// The features of normalised images `[images, height, width, 3]`, whose sides are multiples of [`PATCH`]: those
    /// of all taps side by side, `[images, rows, columns, channels]`.
    pub fn forward(&self, images: Tensor<4>) -> Tensor<4> {
        let [count, height, width, _] = images.dims();
        let (rows, columns) = (height / PATCH, width / PATCH);
        let cut: Tensor<6> = images.reshape([count, rows, PATCH, columns, PATCH, 3]);
        let patches: Tensor<3> =
            cut.permute([0, 1, 3, 5, 2, 4])
                .reshape([count, rows * columns, 3 * PATCH * PATCH]);
        let whole = self.whole.clone().repeat_dim(0, count);
        let tokens = Tensor::cat(vec![whole, self.patches.forward(patches)], 1);
        let mut tokens = tokens + self.places((rows, columns));
        let mut taps = Vec::new();
        for (index, block) in self.blocks.iter().enumerate() {
            tokens = block.forward(tokens, self.config.heads);
            if self.config.taps.contains(&index) {
                taps.push(self.last.forward(tokens.clone().slice(s![.., 1..])));
            }
        }
        let features = Tensor::cat(taps, 2);
        features.reshape([count, rows, columns, self.config.channels()])
    }

    /// The positions of all tokens.
    fn places(&self, size: (usize, usize)) -> Tensor<3> {
        let EncoderConfig { width, side, .. } = self.config;
        let values = positions(&self.positions, side, width, size);
        let shape = [1, values.len() / width, width];
        Tensor::from_data(TensorData::new(values, shape), &self.whole.device())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::random_encoder::{random_tensors, short};
    use lsdc_core::network::Encoder;
    use lsdc_kernels::simd::Level;
    use lsdc_rng::Rng;

    #[test]
    fn it_computes_what_the_prepared_encoder_does() {
        let tensors = random_tensors();
        let device = Device::flex().autodiff();
        let transformer = VisionTransformer::new(short(), &tensors, &device).unwrap();
        let prepared = Encoder::new(short(), &tensors, Level::here()).unwrap();
        let mut rng = Rng::stream(0, &["vision"]);
        let (height, width) = (3 * PATCH, 4 * PATCH);
        let images: Vec<Vec<f32>> = (0..2)
            .map(|_| (0..3 * height * width).map(|_| rng.normal()).collect())
            .collect();
        let data = TensorData::new(images.concat(), [2, height, width, 3]);
        let input = Tensor::<4>::from_data(data, &device).require_grad();
        let output = transformer.forward(input.clone());
        assert_eq!(output.dims(), [2, 3, 4, short().channels()]);
        let gradients = output.clone().sum().backward();
        assert!(input.grad(&gradients).is_some());
        let found: Vec<f32> = output.into_data().iter::<f32>().collect();
        let channels = short().width;
        for (image, found) in images.iter().zip(found.chunks(found.len() / 2)) {
            let expected = prepared.features(image, (height, width)).unwrap();
            for (patch, found) in found.chunks(short().channels()).enumerate() {
                for (tap, found) in expected.taps.iter().zip(found.chunks(channels)) {
                    for (a, b) in found.iter().zip(&tap[patch * channels..]) {
                        assert!((a - b).abs() < 2e-4, "{a} {b}");
                    }
                }
            }
        }
    }
}
