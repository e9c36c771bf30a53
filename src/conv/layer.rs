//! A convolution with weights at rest, and the gradients of one: the algorithm that suits its
//! shape.

use super::shape::Shape;
use super::winograd::{self, Filter};
use super::{ConvSpec, unfold};
use crate::simd::{Level, Packed, Scratch, Tail};

/// A convolution whose weights are prepared for the kernels, with a bias.
#[derive(Clone, Debug)]
pub(crate) struct Layer {
    channels: usize,
    outputs: usize,
    taps: usize,
    spec: ConvSpec,
    weights: Prepared,
}

#[derive(Clone, Debug)]
enum Prepared {
    Spectrum(Filter),
    Matrix(Packed),
}

impl Layer {
    /// Prepares weights `[outputs, channels, taps, taps]`; an empty bias is 0.
    pub(crate) fn new(
        level: Level,
        weights: &[f32],
        [outputs, channels, taps]: [usize; 3],
        bias: &[f32],
        spec: ConvSpec,
    ) -> Self {
        let shape = Shape {
            batch: 1,
            height: 1,
            width: 1,
            channels,
            outputs,
            taps,
            spec,
        };
        let area = taps * taps;
        let weights = if shape.is_winograd() {
            let turned = arrange(weights, [outputs, channels, area], |[o, c, t]| [t, c, o]);
            let sizes = (channels, outputs);
            Prepared::Spectrum(Filter::new(level, &turned, sizes, spec.dilation, bias))
        } else {
            let at = |row: usize, o: usize| {
                weights[(o * channels + row % channels) * area + row / channels]
            };
            Prepared::Matrix(Packed::new(level, (shape.depth(), outputs), bias, at))
        };
        Self {
            channels,
            outputs,
            taps,
            spec,
            weights,
        }
    }

    /// The sizes for a batch of images `[batch, height, width]`.
    pub(crate) fn shape(&self, [batch, height, width]: [usize; 3]) -> Shape {
        Shape {
            batch,
            height,
            width,
            channels: self.channels,
            outputs: self.outputs,
            taps: self.taps,
            spec: self.spec,
        }
    }

    /// `output [batch, height', width', outputs]` from `x [batch, height, width, channels]`.
    pub(crate) fn apply(
        &self,
        x: &[f32],
        size: [usize; 3],
        tail: Tail<'_>,
        scratch: &Scratch,
        output: &mut [f32],
    ) {
        match &self.weights {
            Prepared::Spectrum(filter) => filter.apply(x, size, tail, scratch, output),
            Prepared::Matrix(matrix) => {
                unfold::forward(x, matrix, &self.shape(size), tail, scratch, output);
            }
        }
    }
}

/// The gradient of the input from that of the output, with weights
/// `[outputs, channels, taps, taps]`.
pub(super) fn input_gradient(
    level: Level,
    weights: &[f32],
    grad: &[f32],
    shape: &Shape,
    scratch: &Scratch,
) -> Vec<f32> {
    let (channels, outputs, area) = (shape.channels, shape.outputs, shape.taps * shape.taps);
    if shape.is_winograd() {
        let dims = [outputs, channels, area];
        let turned = arrange(weights, dims, |[o, c, t]| [area - 1 - t, o, c]);
        let dilation = shape.spec.dilation;
        let filter = Filter::new(level, &turned, (outputs, channels), dilation, &[]);
        let mut x = vec![0.0; shape.size().iter().product::<usize>() * channels];
        filter.apply(grad, shape.size(), Tail::default(), scratch, &mut x);
        return x;
    }
    let at = |o: usize, column: usize| {
        weights[(o * channels + column % channels) * area + column / channels]
    };
    let transposed = Packed::new(level, (outputs, shape.depth()), &[], at);
    unfold::input_gradient(grad, &transposed, shape, scratch)
}

/// The gradient of the weights `[outputs, channels, taps, taps]` from that of the output.
pub(super) fn weight_gradient(
    level: Level,
    x: &[f32],
    grad: &[f32],
    shape: &Shape,
    scratch: &Scratch,
) -> Vec<f32> {
    let sizes = (shape.channels, shape.outputs);
    let gradient = if shape.is_winograd() {
        {
            let dilation = shape.spec.dilation;
            winograd::weight_gradient(level, x, grad, shape.size(), sizes, dilation, scratch)
        }
    } else {
        unfold::weight_gradient(level, x, grad, shape, scratch)
    };
    let dims = [shape.taps * shape.taps, shape.channels, shape.outputs];
    arrange(&gradient, dims, |[t, c, o]| [o, c, t])
}

/// Reorders the axes of an array: `to` maps the indices and, in the same way, the sizes.
fn arrange(values: &[f32], dims: [usize; 3], to: impl Fn([usize; 3]) -> [usize; 3]) -> Vec<f32> {
    let last = to([dims[0] - 1, dims[1] - 1, dims[2] - 1]);
    let first = to([0; 3]);
    let sizes: [usize; 3] = std::array::from_fn(|i| last[i].max(first[i]) + 1);
    let mut target = vec![0.0; values.len()];
    let mut values = values.iter();
    for a in 0..dims[0] {
        for b in 0..dims[1] {
            for c in 0..dims[2] {
                let [i, j, k] = to([a, b, c]);
                if let Some(value) = values.next() {
                    target[(i * sizes[1] + j) * sizes[2] + k] = *value;
                }
            }
        }
    }
    target
}
