//! The pretrained encoder on burn's tensors: for devices other than the CPU, and differentiable.

use super::Table;
use super::adapters::{Adapter, Adapters};
use burn::tensor::activation::{gelu, softmax};
use burn::tensor::{Device, Tensor, TensorData, s};
use lsdc_core::WeightsError;
use lsdc_core::network::{EncoderConfig, LAYER_EPSILON, MORE_BLOCKS, PATCH, positions};
use std::collections::BTreeMap;

/// A vision transformer, as [`lsdc_core::network::Encoder`] computes it, on any device.
#[derive(Clone, Debug)]
pub struct VisionTransformer {
    config: EncoderConfig,
    patches: Affine,
    whole: Tensor<3>,
    /// `[1 + side x side, width]`; interpolated on the host.
    positions: Vec<f32>,
    blocks: LastBlocks,
}

/// The last blocks of one, and the normalisation after them.
#[derive(Clone, Debug)]
pub struct LastBlocks {
    /// The first of them, from 0.
    first: usize,
    /// The blocks of the encoder whose tokens are features.
    taps: Vec<usize>,
    heads: usize,
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

    fn to_device(&self, device: &Device) -> Self {
        let norm = |norm: &Norm| Norm {
            gain: norm.gain.clone().to_device(device),
            shift: norm.shift.clone().to_device(device),
        };
        let affine = |affine: &Affine| Affine {
            weight: affine.weight.clone().to_device(device),
            bias: affine.bias.clone().to_device(device),
        };
        Self {
            norms: self.norms.each_ref().map(norm),
            queries: affine(&self.queries),
            mixed: affine(&self.mixed),
            first: affine(&self.first),
            second: affine(&self.second),
            scales: self
                .scales
                .each_ref()
                .map(|scale| scale.clone().to_device(device)),
        }
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
        let source = Source { tensors, device };
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

    /// A copy on another device.
    #[must_use]
    pub fn to_device(&self, device: &Device) -> Self {
        Self {
            blocks: self.blocks.iter().map(|b| b.to_device(device)).collect(),
            last: Norm {
                gain: self.last.gain.clone().to_device(device),
                shift: self.last.shift.clone().to_device(device),
            },
            taps: self.taps.clone(),
            ..*self
        }
    }

    /// From the tokens that enter the first of them, `[images, 1 + patches, width]`, the features of the taps among them
    /// `[images, patches, channels]`.
    fn forward(&self, mut tokens: Tensor<3>, adapters: Option<&Adapters>) -> Vec<Tensor<3>> {
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
        let kept = channels - new.dims()[2];
        let new = new.reshape([images, rows, columns, channels - kept]);
        if kept == 0 {
            return new;
        }
        Tensor::cat(vec![encoded.slice(s![.., .., .., ..kept]), new], 3)
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
            blocks: LastBlocks::new(&config, config.blocks, tensors, device)?,
            config,
        })
    }

    /// The features of normalised images `[images, height, width, 3]`, whose sides are multiples of [`PATCH`]: those
    /// of all taps side by side, `[images, rows, columns, channels]`; with adapters if they are given.
    pub fn forward(&self, images: Tensor<4>, adapters: Option<&Adapters>) -> Tensor<4> {
        let [count, height, width, _] = images.dims();
        let (rows, columns) = (height / PATCH, width / PATCH);
        let cut: Tensor<6> = images.reshape([count, rows, PATCH, columns, PATCH, 3]);
        let patches: Tensor<3> =
            cut.permute([0, 1, 3, 5, 2, 4])
                .reshape([count, rows * columns, 3 * PATCH * PATCH]);
        let whole = self.whole.clone().repeat_dim(0, count);
        let tokens = Tensor::cat(vec![whole, self.patches.forward(patches)], 1);
        let tokens = tokens + self.places((rows, columns));
        let features = Tensor::cat(self.blocks.forward(tokens, adapters), 2);
        features.reshape([count, rows, columns, self.config.channels()])
    }

    /// The number of blocks.
    pub(super) fn blocks(&self) -> usize {
        self.blocks.count()
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
    use crate::model::layers::Init;
    use crate::model::random_encoder::{random_tensors, short};
    use crate::model::weights::Filler;
    use crate::model::{AdapterConfig, NormKind};
    use burn::module::{Module as _, ModuleMapper, Param};
    use lsdc_core::network::{ADAPTERS, Encoder};
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
        let output = transformer.forward(input.clone(), None);
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

    const LAST_TWO: AdapterConfig = AdapterConfig { blocks: 2, rank: 3 };

    /// Adapters of random numbers, 0 nowhere.
    fn adapters(device: &Device) -> Adapters {
        let mut init = Init {
            rng: Some(Rng::stream(0, &["adapters"])),
            norm: NormKind::Batch,
            momentum: 0.1,
            device: device.clone(),
        };
        let zero = Adapters::init(LAST_TWO, short().width, &mut init);
        let tensors = zero.tensors().into_iter().map(|(name, table)| {
            let mut rng = Rng::stream(1, &[&name]);
            let values = table.values().iter().map(|_| 0.1 * rng.normal()).collect();
            let name = name.trim_start_matches(ADAPTERS).to_owned();
            (name, Table::new(table.shape().to_vec(), values).unwrap())
        });
        let mut filler = Filler::new(tensors.collect());
        let adapters = zero.map(&mut filler);
        filler.check().unwrap();
        adapters
    }

    fn pixels(size: (usize, usize)) -> Vec<f32> {
        let mut rng = Rng::stream(2, &["vision"]);
        (0..3 * size.0 * size.1).map(|_| rng.normal()).collect()
    }

    fn largest(a: &[f32], b: &[f32]) -> f32 {
        assert_eq!(a.len(), b.len());
        let pairs = a.iter().zip(b);
        pairs.fold(0.0, |most, (a, b)| most.max((a - b).abs()))
    }

    /// With adapters, all blocks and the last blocks alone say what the prepared encoder does whose weights were changed.
    #[test]
    fn adapters_are_those_of_the_prepared_encoder() {
        let tensors = random_tensors();
        let device = Device::flex();
        let adapters = adapters(&device);
        let prepared = Encoder::new(short(), &tensors, Level::here()).unwrap();
        let changed = prepared
            .with_adapters(adapters.config(), &adapters.tensors())
            .unwrap();
        let size = (4 * PATCH, 3 * PATCH);
        let image = pixels(size);
        let said = |encoder: &Encoder| encoder.features(&image, size).unwrap().taps;
        let (plain, exact) = (said(&prepared), said(&changed));
        assert!(largest(&exact.concat(), &plain.concat()) > 0.1);

        let side_by_side = |taps: &[Vec<f32>]| -> Vec<f32> {
            let width = short().width;
            let rows = 0..taps[0].len() / width;
            rows.flat_map(|row| {
                taps.iter()
                    .flat_map(move |tap| &tap[row * width..][..width])
            })
            .copied()
            .collect()
        };
        let tensor = |values: Vec<f32>, shape: [usize; 4]| {
            Tensor::<4>::from_data(TensorData::new(values, shape), &device)
        };
        let transformer = VisionTransformer::new(short(), &tensors, &device).unwrap();
        let input = tensor(image.clone(), [1, size.0, size.1, 3]);
        let whole = transformer.forward(input, Some(&adapters));
        let whole: Vec<f32> = whole.into_data().iter::<f32>().collect();
        assert!(largest(&whole, &side_by_side(&exact)) < 2e-4);

        let last = LastBlocks::new(&short(), 2, &tensors, &device).unwrap();
        let entering = prepared.entering(&image, size, last.first()).unwrap();
        let entering = TensorData::new(entering, [1, 13, short().width]);
        let encoded = tensor(side_by_side(&plain), [1, 4, 3, short().channels()]);
        let entering = Tensor::from_data(entering, &device);
        let found = last.features(encoded, entering, &adapters);
        let found: Vec<f32> = found.into_data().iter::<f32>().collect();
        assert!(largest(&found, &side_by_side(&exact)) < 2e-4);
        assert!(LastBlocks::new(&short(), 5, &tensors, &device).is_err());
    }

    /// Against central differences of a weighted sum of the features.
    #[test]
    fn adapters_are_differentiable() {
        const STEP: f32 = 2e-2;
        let tensors = random_tensors();
        let device = Device::flex().autodiff();
        let last = LastBlocks::new(&short(), 2, &tensors, &device).unwrap();
        let mut rng = Rng::stream(3, &["tokens"]);
        let mut normal = |shape: [usize; 3]| {
            let values: Vec<f32> = (0..shape.iter().product()).map(|_| rng.normal()).collect();
            Tensor::<3>::from_data(TensorData::new(values, shape), &device)
        };
        let width = short().width;
        let (tokens, weights) = (normal([2, 7, width]), normal([2, 6, 2 * width]));
        let weights: Tensor<4> = weights.reshape([2, 2, 3, 2 * width]);
        let loss = |adapters: &Adapters| {
            // Features of the blocks before are as they are.
            let encoded = Tensor::zeros([2, 2, 3, 4 * width], &device);
            let features = last.features(encoded, tokens.clone(), adapters);
            (features.slice(s![.., .., .., 2 * width..]) * weights.clone()).sum()
        };
        let adapters = adapters(&device);
        let gradients = loss(&adapters).backward();
        let of = |layer: &Param<Tensor<2>>| -> Vec<f32> {
            let gradient = layer.grad(&gradients).unwrap();
            gradient.into_data().iter::<f32>().collect()
        };
        for (block, adapter) in adapters.blocks.iter().enumerate() {
            for (part, change) in [("queries", &adapter.queries), ("values", &adapter.values)] {
                for (matrix, layer) in [("down", change.down()), ("up", change.up())] {
                    let gradient = of(layer);
                    // Along the gradient, so that the difference is larger than rounding.
                    let length = gradient.iter().map(|g| g * g).sum::<f32>().sqrt();
                    assert!(length > 1e-2, "{block} {part} {matrix}: {length}");
                    let moved = |step: f32| {
                        let name = format!("blocks.{block}.{part}.{matrix}.weight");
                        let change: Vec<f32> = gradient.iter().map(|g| step * g / length).collect();
                        let moved = adapters.clone().map(&mut Moved {
                            name,
                            change,
                            path: Vec::new(),
                        });
                        loss(&moved).into_scalar::<f32>()
                    };
                    let slope = (moved(STEP) - moved(-STEP)) / (2.0 * STEP);
                    assert!(
                        (slope - length).abs() < 2e-2 * length,
                        "{block} {part} {matrix}: {slope} {length}"
                    );
                }
            }
        }
    }

    /// Adds to the tensor of a name.
    struct Moved {
        name: String,
        change: Vec<f32>,
        path: Vec<String>,
    }

    impl ModuleMapper for Moved {
        fn enter_module(&mut self, name: &str, _: &str) {
            self.path.push(name.to_owned());
        }

        fn exit_module(&mut self, _: &str, _: &str) {
            self.path.pop();
        }

        fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
            if self.path.join(".") != self.name {
                return param;
            }
            let change = TensorData::new(self.change.clone(), param.dims());
            param.map(|tensor| tensor.clone() + Tensor::from_data(change, &tensor.device()))
        }
    }
}
