//! The per-pixel MLP, and basis functions evaluated at any pixel of any output size.

use super::extractor::ExtractorOutput;
use super::layers::{Hidden, Init, Linear};
use super::{encoding, grid};
use crate::device::is_gpu;
use burn::module::Module;
use burn::tensor::{Device, Int, Tensor, TensorData};
use lsdc_core::network::MAX_LOG_DEPTH;
use lsdc_core::network::NetworkConfig;
use rayon::prelude::*;
use std::ops::Range;

/// The MLP from features and position to N basis functions (paper section 3.2).
#[derive(Module, Debug)]
pub struct BasisHead {
    pub(super) hidden: Vec<Hidden>,
    pub(super) last: Linear,
    /// Layer that predicts the logarithm of the first basis function, if that is a map and no backbone predicts it; zero before
    /// training.
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
            mean: (config.mean && config.extractor.backbone.is_none())
                .then(|| Linear::zero(width, 1, init)),
            octaves: config.octaves,
        }
    }

    /// Returns the last hidden layer for rows `[rows, features + position]`.
    fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        self.hidden.iter().fold(x, |x, layer| layer.forward(x))
    }
}

/// Basis functions of a batch of images: features `[batch, height / 4, width / 4, channels]`, and the MLP that evaluates them
/// at any pixel of any output size (paper section 4.5).
#[derive(Clone, Debug)]
pub struct Bases {
    extracted: ExtractorOutput,
    head: BasisHead,
}

impl Bases {
    pub(super) fn new(extracted: ExtractorOutput, head: BasisHead) -> Self {
        Self { extracted, head }
    }

    /// Returns the values at pixels of an output of `size` (height, width): `[batch, pixels, N + 1]`. The first function is the
    /// constant 1 or the mean.
    ///
    /// `pixels[b]` lists `y * width + x` for image `b`; all lists have the same length.
    pub fn at(&self, size: (usize, usize), pixels: &[Vec<u32>]) -> Tensor<3> {
        self.hidden_at(size, pixels).functions()
    }

    /// Returns the hidden layer from which basis functions at pixels are computed, as in [`Bases::at`].
    pub fn hidden_at(&self, size: (usize, usize), pixels: &[Vec<u32>]) -> HiddenBases {
        let octaves = self.head.octaves;
        let encode = |list: &Vec<u32>| encoding::encode(size, list, octaves);
        self.hidden(
            [pixels.len(), pixels.first().map_or(0, Vec::len)],
            |map| grid::sample(map, size, pixels),
            |device| {
                if is_gpu(&device.clone().inner()) {
                    return encoding::encode_on_device(size, pixels, octaves, device);
                }
                let codes = pixels.par_iter().map(encode).collect::<Vec<_>>().concat();
                rows_of(codes, octaves, device)
            },
        )
    }

    /// Returns [`Bases::hidden_at`], and the values of all functions at the first `count` pixels of each image.
    ///
    /// If batch normalisation has fixed statistics, the values are computed separately, because the gradient of a part of a
    /// large tensor is as large as the tensor.
    pub fn hidden_and_first(
        &self,
        size: (usize, usize),
        pixels: &[Vec<u32>],
        count: usize,
    ) -> (HiddenBases, Tensor<3>) {
        let hidden = self.hidden_at(size, pixels);
        let device = self.extracted.features.device();
        let first = if self.head.hidden.iter().all(|layer| layer.is_fixed(&device)) {
            let lists = pixels.iter().map(|list| list[..count].to_vec());
            self.at(size, &lists.collect::<Vec<_>>())
        } else {
            hidden.slice(0..count).functions()
        };
        (hidden, first)
    }

    /// Returns the values at positions (u, v) of an output of `size` (height, width) of a single image: `[1, places, N + 1]`.
    /// Positions are in pixels, relative to the centre of the first pixel.
    pub fn at_places(&self, size: (usize, usize), places: &[[f64; 2]]) -> Tensor<3> {
        let hidden = self.hidden(
            [1, places.len()],
            |map| grid::sample_places(map, size, places),
            |device| {
                let octaves = self.head.octaves;
                let codes = encoding::encode_places(size, places, octaves);
                rows_of(codes, octaves, device)
            },
        );
        hidden.functions()
    }

    /// Runs the hidden layers of the MLP on maps read by `sample` and on the codes of the positions.
    fn hidden(
        &self,
        [batch, count]: [usize; 2],
        sample: impl Fn(Tensor<4>) -> Tensor<2>,
        codes: impl FnOnce(&Device) -> Tensor<2>,
    ) -> HiddenBases {
        let ExtractorOutput {
            features,
            logarithm,
        } = self.extracted.clone();
        let device = features.device();
        let mut rows = sample(features);
        let logarithm = logarithm.map(sample);
        let width = encoding::channels(self.head.octaves);
        if width > 0 {
            rows = Tensor::cat(vec![rows, codes(&device)], 1);
        }
        let hidden = self.head.forward(rows);
        let width = hidden.dims()[1];
        HiddenBases {
            hidden: hidden.reshape([batch, count, width]),
            logarithm: logarithm.map(|rows| rows.reshape([batch, count, 1])),
            head: self.head.clone(),
        }
    }

    /// Returns basis functions times weights over the whole output, for one image: `size.0 * size.1` depths.
    ///
    /// Processes strips of rows, so that memory use does not grow with the output.
    pub fn combine(&self, size: (usize, usize), weights: &[f32]) -> Vec<f32> {
        const STRIP: usize = 1 << 15;
        let device = self.extracted.features.device();
        let column = TensorData::new(weights.to_vec(), [1, weights.len(), 1]);
        let column = Tensor::<3>::from_data(column, &device);
        let total = size.0 * size.1;
        let mut depths = Vec::with_capacity(total);
        for start in (0..total).step_by(STRIP) {
            let pixels = (start..(start + STRIP).min(total))
                .map(|i| i as u32)
                .collect();
            let strip = self.hidden_at(size, &[pixels]);
            let values = strip.combine(column.clone()).into_data();
            depths.extend(values.iter::<f32>());
        }
        depths
    }
}

/// The last hidden layer of the MLP at pixels of a batch of images. All basis functions but the first are linear in it, so
/// weighted sums of them can be computed without evaluating each.
#[derive(Clone, Debug)]
pub struct HiddenBases {
    /// `[batch, pixels, width]`
    hidden: Tensor<3>,
    /// Logarithm of the first basis function, `[batch, pixels, 1]`, if the extractor predicts it.
    logarithm: Option<Tensor<3>>,
    head: BasisHead,
}

impl HiddenBases {
    /// Returns the hidden layer at some of the pixels of each image.
    #[must_use]
    pub fn slice(&self, pixels: Range<usize>) -> Self {
        let batch = self.hidden.dims()[0];
        Self {
            hidden: self.hidden.clone().slice([0..batch, pixels.clone()]),
            logarithm: (self.logarithm.clone()).map(|map| map.slice([0..batch, pixels])),
            head: self.head.clone(),
        }
    }

    /// Returns the hidden layer at every `step`th pixel of each image, starting with the first.
    #[must_use]
    pub fn every(&self, step: usize) -> Self {
        Self {
            hidden: every(self.hidden.clone(), step),
            logarithm: self.logarithm.clone().map(|map| every(map, step)),
            head: self.head.clone(),
        }
    }

    /// Returns the values of all functions, `[batch, pixels, N + 1]`.
    pub fn functions(&self) -> Tensor<3> {
        let [batch, pixels, _] = self.hidden.dims();
        let first = self.first().reshape([batch * pixels, 1]);
        let values = Tensor::cat(vec![first, self.head.last.forward(self.rows())], 1);
        let functions = values.dims()[1];
        values.reshape([batch, pixels, functions])
    }

    /// Returns the first function, the constant or the map, `[batch, pixels, 1]`.
    fn first(&self) -> Tensor<3> {
        let [batch, pixels, _] = self.hidden.dims();
        let logarithm = match (&self.logarithm, &self.head.mean) {
            (Some(logarithm), _) => logarithm.clone(),
            (None, Some(mean)) => mean.forward(self.rows()).reshape([batch, pixels, 1]),
            (None, None) => return Tensor::ones([batch, pixels, 1], &self.hidden.device()),
        };
        positive(logarithm)
    }

    /// Returns sums of the functions with weights `[batch, N + 1, sums]`: `[batch, pixels, sums]`. Equal to the product of
    /// [`HiddenBases::functions`] and weights, but `N / sums` times cheaper.
    pub fn combine(&self, weights: Tensor<3>) -> Tensor<3> {
        let first = self.first();
        let functions = weights.dims()[1];
        let last = self.head.last.weights().unsqueeze::<3>();
        let (scale, others) = (
            weights.clone().narrow(1, 0, 1),
            weights.narrow(1, 1, functions - 1),
        );
        self.hidden.clone().matmul(last.matmul(others)) + first * scale
    }

    fn rows(&self) -> Tensor<2> {
        self.hidden.clone().flatten(0, 1)
    }
}

/// Returns codes of positions as rows.
fn rows_of(codes: Vec<f32>, octaves: usize, device: &Device) -> Tensor<2> {
    let width = encoding::channels(octaves);
    let rows = codes.len() / width.max(1);
    Tensor::from_data(TensorData::new(codes, [rows, width]), device)
}

/// Returns a map from its logarithm.
fn positive<const D: usize>(logarithm: Tensor<D>) -> Tensor<D> {
    logarithm.clamp(-MAX_LOG_DEPTH, MAX_LOG_DEPTH).exp()
}

/// Returns a depth map at pixels of images of `size` (height, width), `[batch, pixels]`, from its logarithm `[batch, h, w, 1]`.
pub(super) fn map_at(logarithm: Tensor<4>, size: (usize, usize), pixels: &[Vec<u32>]) -> Tensor<2> {
    let rows = grid::sample(logarithm, size, pixels);
    positive(rows).reshape([pixels.len(), pixels.first().map_or(0, Vec::len)])
}

/// Returns every `step`th entry of the second axis, starting with the first.
pub(crate) fn every<const D: usize>(values: Tensor<D>, step: usize) -> Tensor<D> {
    let some: Vec<i32> = (0..values.dims()[1] as i32).step_by(step).collect();
    let some = TensorData::new(some.clone(), [some.len()]);
    let some = Tensor::<1, Int>::from_data(some, &values.device());
    values.select(1, some)
}
