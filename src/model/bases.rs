//! The per-pixel MLP, and basis functions that can be read at any pixel of any output size.

use super::layers::{Hidden, Init, Linear};
use super::{NetworkConfig, encoding, grid};
use burn::module::Module;
use burn::tensor::{Tensor, TensorData};
use lsdc_core::network::STEEPEST;

/// The MLP from features and position to N basis functions (paper section 3.2).
#[derive(Module, Debug)]
pub struct BasisHead {
    pub(super) hidden: Vec<Hidden>,
    pub(super) last: Linear,
    /// To the logarithm of the first function, if that is not the constant 1: 0 before training.
    pub(super) mean: Option<Linear>,
    #[module(skip)]
    pub(super) octaves: usize,
}

impl BasisHead {
    pub(super) fn init(config: &NetworkConfig, init: &mut Init) -> Self {
        let mut width = config.extractor.features + encoding::channels(config.octaves);
        let mut hidden = Vec::new();
        for &next in &config.hidden {
            hidden.push(Hidden::init(width, next, init));
            width = next;
        }
        Self {
            hidden,
            last: Linear::init(width, config.bases, init),
            mean: config.mean.then(|| Linear::zero(width, 1, init)),
            octaves: config.octaves,
        }
    }

    /// `[rows, features + position]` to `[rows, N + 1]`, the constant or the mean first.
    fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        let x = self.hidden.iter().fold(x, |x, layer| layer.forward(x));
        let first = match &self.mean {
            None => Tensor::ones([x.dims()[0], 1], &x.device()),
            Some(mean) => mean.forward(x.clone()).clamp(-STEEPEST, STEEPEST).exp(),
        };
        Tensor::cat(vec![first, self.last.forward(x)], 1)
    }
}

/// The basis functions of a batch of images: features `[batch, height / 4, width / 4, channels]`,
/// and the MLP that turns them into values at any pixel of any output size (paper section 4.5).
#[derive(Clone, Debug)]
pub struct Bases {
    features: Tensor<4>,
    head: BasisHead,
}

impl Bases {
    pub(super) fn new(features: Tensor<4>, head: BasisHead) -> Self {
        Self { features, head }
    }

    /// Values at pixels of an output of `size` (height, width): `[batch, pixels, N + 1]`, the
    /// first function being the constant 1 or the mean.
    ///
    /// `pixels[b]` lists `y * width + x` for image `b`, equally many for each.
    pub fn at(&self, size: (usize, usize), pixels: &[Vec<u32>]) -> Tensor<3> {
        let device = self.features.device();
        let batch = pixels.len();
        let count = pixels.first().map_or(0, Vec::len);
        let mut input = grid::sample(self.features.clone(), size, pixels);
        let width = encoding::channels(self.head.octaves);
        if width > 0 {
            let codes = pixels
                .iter()
                .flat_map(|list| encoding::encode(size, list, self.head.octaves))
                .collect::<Vec<f32>>();
            let codes = TensorData::new(codes, [batch * count, width]);
            input = Tensor::cat(vec![input, Tensor::from_data(codes, &device)], 1);
        }
        self.evaluate(input, [batch, count])
    }

    /// Values at places (u, v) of an output of `size` (height, width) of a single image: `[1, places,
    /// N + 1]`. Places count in pixels from the centre of the first.
    pub fn at_places(&self, size: (usize, usize), places: &[[f64; 2]]) -> Tensor<3> {
        let device = self.features.device();
        let mut input = grid::sample_places(self.features.clone(), size, places);
        let width = encoding::channels(self.head.octaves);
        if width > 0 {
            let codes = encoding::encode_places(size, places, self.head.octaves);
            let codes = TensorData::new(codes, [places.len(), width]);
            input = Tensor::cat(vec![input, Tensor::from_data(codes, &device)], 1);
        }
        self.evaluate(input, [1, places.len()])
    }

    /// The MLP on rows of features and position.
    fn evaluate(&self, input: Tensor<2>, [batch, count]: [usize; 2]) -> Tensor<3> {
        let values = self.head.forward(input);
        let functions = values.dims()[1];
        values.reshape([batch, count, functions])
    }

    /// Bases x weights over the whole output, for one image: `size.0 * size.1` depths.
    ///
    /// Works on strips of rows, so memory does not grow with the output.
    pub fn combine(&self, size: (usize, usize), weights: &[f32]) -> Vec<f32> {
        const STRIP: usize = 1 << 15;
        let device = self.features.device();
        let column = TensorData::new(weights.to_vec(), [weights.len(), 1]);
        let column = Tensor::<2>::from_data(column, &device);
        let total = size.0 * size.1;
        let mut depths = Vec::with_capacity(total);
        for start in (0..total).step_by(STRIP) {
            let pixels = (start..(start + STRIP).min(total))
                .map(|i| i as u32)
                .collect();
            let strip = self.at(size, &[pixels]).squeeze_dim::<2>(0);
            let values = strip.matmul(column.clone()).into_data();
            depths.extend(values.iter::<f32>());
        }
        depths
    }
}
