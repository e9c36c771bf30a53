use super::*;
use crate::model::layers::Init;
use crate::model::random_encoder::{random_tensors, short};
use crate::model::weights::fill;
use burn::module::{Module as _, ModuleMapper, Param};
use burn::tensor::s;
use lsdc_core::network::{ADAPTERS, Encoder};
use lsdc_core::network::{AdapterConfig, NormKind};
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
    fill(tensors.collect(), zero).unwrap()
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
    let entering = prepared.tokens_before(&image, size, last.first()).unwrap();
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
