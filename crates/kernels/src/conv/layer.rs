//! A convolution with prepared weights, and the gradients of a convolution; the algorithm depends on the shape.

use super::shape::Shape;
use super::winograd::{self, Filter};
use super::{ConvSpec, depthwise, unfold};
use crate::simd::{Level, Packed, Scratch, Tail, Unset, unset, written};
use rayon::prelude::*;

/// A convolution with a bias and weights that are prepared for the kernels.
#[derive(Clone, Debug)]
pub struct Layer {
    /// The shape for an image of one pixel.
    shape: Shape,
    weights: Weights,
}

#[derive(Clone, Debug)]
enum Weights {
    Depthwise(depthwise::Filter),
    Winograd(Filter),
    Matrix(Packed),
}

impl Layer {
    /// Prepares weights `[outputs, channels, taps, taps]`, with 1 channel in a depthwise convolution; an empty bias is 0.
    ///
    /// # Panics
    /// If the number of weights or biases does not match, or taps, stride or dilation are 0.
    pub fn new(
        level: Level,
        weights: &[f32],
        [outputs, channels, taps]: [usize; 3],
        bias: &[f32],
        spec: ConvSpec,
    ) -> Self {
        assert_eq!(weights.len(), outputs * channels * taps * taps, "weights");
        assert!(bias.is_empty() || bias.len() == outputs, "bias");
        assert!(!spec.depthwise || channels == 1, "depthwise weights");
        let channels = if spec.depthwise { outputs } else { channels };
        let shape = Shape {
            batch: 1,
            height: 1,
            width: 1,
            channels,
            outputs,
            taps,
            spec,
        };
        shape.check();
        let area = taps * taps;
        let weights = if spec.depthwise {
            Weights::Depthwise(depthwise::Filter::new(level, weights, channels, bias))
        } else if shape.is_winograd() {
            let weights = transposed(weights, outputs, channels * area);
            let sizes = (channels, outputs);
            Weights::Winograd(Filter::new(level, &weights, sizes, spec.dilation, bias))
        } else {
            let at = |row: usize, o: usize| {
                weights[(o * channels + row % channels) * area + row / channels]
            };
            Weights::Matrix(Packed::new(level, (shape.depth(), outputs), bias, at))
        };
        Self { shape, weights }
    }

    /// The shape for a batch of images `[batch, height, width]`.
    pub fn shape(&self, [batch, height, width]: [usize; 3]) -> Shape {
        Shape {
            batch,
            height,
            width,
            ..self.shape
        }
    }

    /// Computes `output [batch, height', width', outputs]` from `x [batch, height, width, channels]` of `size` (batch, height,
    /// width).
    ///
    /// # Panics
    /// If the length of a slice does not match.
    pub fn apply(
        &self,
        x: &[f32],
        size: [usize; 3],
        tail: Tail<'_>,
        scratch: &Scratch,
        output: &mut [f32],
    ) {
        // SAFETY: `write` writes floats.
        self.write(x, size, tail, scratch, unsafe { unset(output) });
    }

    /// Like [`Self::apply`], with a new output.
    ///
    /// # Panics
    /// If the length of a slice does not match.
    pub fn output(
        &self,
        x: &[f32],
        size: [usize; 3],
        tail: Tail<'_>,
        scratch: &Scratch,
    ) -> Vec<f32> {
        let length = self.shape(size).output_len();
        let write = |output: &mut Unset| self.write(x, size, tail, scratch, output);
        // SAFETY: `write` sets every float.
        unsafe { written(length, write) }
    }

    /// Like `apply`; sets every float of the output.
    fn write(
        &self,
        x: &[f32],
        size: [usize; 3],
        tail: Tail<'_>,
        scratch: &Scratch,
        output: &mut Unset,
    ) {
        let shape = self.shape(size);
        let outputs = shape.output_len();
        assert_eq!(x.len(), shape.input_len(), "input");
        assert_eq!(output.len(), outputs, "output");
        assert!(tail.skip.is_none_or(|skip| skip.len() == outputs), "skip");
        match &self.weights {
            Weights::Depthwise(filter) => filter.write(x, &shape, tail, output),
            Weights::Winograd(filter) => filter.write(x, size, tail, scratch, output),
            Weights::Matrix(matrix) => unfold::forward(x, matrix, &shape, tail, scratch, output),
        }
    }
}

/// The gradient of the input from that of the output, with weights `[outputs, channels, taps, taps]` (1 channel in a depthwise
/// convolution).
///
/// # Panics
/// If lengths do not match, or taps, stride or dilation are 0.
pub fn input_gradient(
    level: Level,
    weights: &[f32],
    grad: &[f32],
    shape: &Shape,
    scratch: &Scratch,
) -> Vec<f32> {
    shape.check();
    let (channels, outputs, area) = (shape.channels, shape.outputs, shape.taps * shape.taps);
    assert_eq!(weights.len(), outputs * shape.depth(), "weights");
    assert_eq!(grad.len(), shape.output_len(), "gradient");
    if shape.spec.depthwise {
        return depthwise::input_gradient(level, weights, grad, shape);
    }
    if shape.is_winograd() {
        let adjoint = reversed(weights, channels);
        let dilation = shape.spec.dilation;
        let filter = Filter::new(level, &adjoint, (outputs, channels), dilation, &[]);
        let tail = Tail::default();
        let write = |x: &mut Unset| filter.write(grad, shape.size(), tail, scratch, x);
        // SAFETY: `write` sets every float.
        return unsafe { written(shape.input_len(), write) };
    }
    let at = |o: usize, column: usize| {
        weights[(o * channels + column % channels) * area + column / channels]
    };
    let transposed = Packed::new(level, (outputs, shape.depth()), &[], at);
    unfold::input_gradient(grad, &transposed, shape, scratch)
}

/// The gradient of the weights `[outputs, channels, taps, taps]` (1 channel in a depthwise convolution) from that of the
/// output.
///
/// # Panics
/// If lengths do not match, or taps, stride or dilation are 0.
pub fn weight_gradient(
    level: Level,
    x: &[f32],
    grad: &[f32],
    shape: &Shape,
    scratch: &Scratch,
) -> Vec<f32> {
    shape.check();
    let (channels, outputs, area) = (shape.channels, shape.outputs, shape.taps * shape.taps);
    assert_eq!(x.len(), shape.input_len(), "input");
    assert_eq!(grad.len(), shape.output_len(), "gradient");
    if grad.is_empty() {
        return vec![0.0; outputs * shape.depth()];
    }
    if shape.spec.depthwise {
        return depthwise::weight_gradient(level, x, grad, shape);
    }
    if shape.is_winograd() {
        let gradient = winograd::weight_gradient(level, x, grad, shape, scratch);
        return transposed(&gradient, channels * area, outputs);
    }
    let gradient = unfold::weight_gradient(level, x, grad, shape, scratch);
    let mut target = vec![0.0; gradient.len()];
    for (i, row) in gradient.chunks_exact(outputs.max(1)).enumerate() {
        let (tap, channel) = (i / channels, i % channels);
        for (o, value) in row.iter().enumerate() {
            target[(o * channels + channel) * area + tap] = *value;
        }
    }
    target
}

/// Transposes `[rows, columns]` to `[columns, rows]`.
pub(super) fn transposed(values: &[f32], rows: usize, columns: usize) -> Vec<f32> {
    /// Size of a block: a cache line of each row.
    const BLOCK: usize = 16;
    let mut target = vec![0.0; values.len()];
    let blocks = target.par_chunks_mut((BLOCK * rows).max(1)).enumerate();
    blocks.for_each(|(i, block)| {
        let first = i * BLOCK;
        let count = BLOCK.min(columns - first);
        for (r, row) in values.chunks_exact(columns).enumerate() {
            for (c, value) in row[first..first + count].iter().enumerate() {
                block[c * rows + r] = *value;
            }
        }
    });
    target
}

/// Returns the weights of the adjoint convolution of `[outputs, channels, 3, 3]`, with taps in reverse:
/// `[outputs, 3, 3, channels]`.
fn reversed(weights: &[f32], channels: usize) -> Vec<f32> {
    let mut target = vec![0.0; weights.len()];
    let size = 9 * channels;
    let filters = target.par_chunks_mut(size).zip(weights.par_chunks(size));
    filters.for_each(|(target, weights)| {
        for (c, taps) in weights.chunks_exact(9).enumerate() {
            for (t, tap) in taps.iter().rev().enumerate() {
                target[t * channels + c] = *tap;
            }
        }
    });
    target
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shape(batch: usize, dilation: usize) -> Shape {
        let spec = ConvSpec {
            dilation,
            ..ConvSpec::same(1)
        };
        Shape {
            batch,
            height: 4,
            width: 4,
            channels: 2,
            outputs: 3,
            taps: 3,
            spec,
        }
    }

    #[test]
    #[should_panic(expected = "dilation must be above 0")]
    fn a_dilation_of_0_is_refused() {
        let spec = ConvSpec {
            padding: 0,
            ..shape(1, 0).spec
        };
        Layer::new(Level::here(), &[0.0; 54], [3, 2, 3], &[], spec);
    }

    #[test]
    fn the_gradient_of_no_image_is_0_whatever_was_computed_before() {
        let scratch = Scratch::new();
        let (x, grad) = ([1.0; 32], [1.0; 48]);
        let one = weight_gradient(Level::here(), &x, &grad, &shape(1, 1), &scratch);
        assert!(one.iter().any(|v| *v != 0.0));
        let none = weight_gradient(Level::here(), &[], &[], &shape(0, 1), &scratch);
        assert_eq!(none, vec![0.0; 54]);
    }
}
