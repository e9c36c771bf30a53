//! A convolution followed by a batch normalisation with fixed statistics, as one burn extension operation. On flex the
//! normalisation is folded into the weights, forward and backward, so that it needs no pass over memory.

mod autodiff;
mod flex;
#[cfg(test)]
mod tests;

use super::conv::{ConvBackend, ConvGradients, ConvSpec};
use super::norm::{NormBackend, NormGradients, NormSpec};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, backend_extension};
use burn::tensor::Tensor;

/// Settings of a convolution with a normalisation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConvNormSpec {
    /// Settings of the convolution.
    pub conv: ConvSpec,
    /// Added to the variance.
    pub epsilon: f64,
    /// Whether a ReLU follows.
    pub relu: bool,
}

impl ConvNormSpec {
    fn norm(self) -> NormSpec {
        NormSpec {
            epsilon: self.epsilon,
            relu: self.relu,
            own: false,
        }
    }
}

/// The gain, shift, mean and variance of a normalisation, `[channels]` each.
#[derive(Clone, Debug)]
pub struct FixedNorm {
    /// Factor of the standardised values.
    pub gain: Tensor<1>,
    /// Offset added to the product.
    pub shift: Tensor<1>,
    /// Mean; not differentiated.
    pub mean: Tensor<1>,
    /// Variance; not differentiated.
    pub variance: Tensor<1>,
}

/// Backends with convolution and normalisation; the defaults run one after the other, the plain reference.
#[backend_extension(
    Autodiff,
    Flex,
    NdArray: cfg(feature = "ndarray"),
    Cube: cfg(feature = "wgpu"),
)]
pub trait ConvNormBackend: Backend + ConvBackend + NormBackend {
    /// Returns the output `[b, h', w', o]`, and the values needed by the backward pass.
    fn conv_norm(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        gain: FloatTensor<Self>,
        shift: FloatTensor<Self>,
        mean: FloatTensor<Self>,
        variance: FloatTensor<Self>,
        spec: ConvNormSpec,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        reference::<Self>(x, weight, gain, shift, mean, variance, spec)
    }
}

/// Gradients of [`ConvNormBackend::conv_norm`]; the defaults are the plain reference.
pub trait ConvNormGradients: ConvNormBackend + ConvGradients + NormGradients {
    /// Computes, from the gradient of the output: a gradient for [`ConvNormGradients::conv_norm_backward_input`], and those of
    /// weight, gain and shift.
    fn conv_norm_backward(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        gain: FloatTensor<Self>,
        shift: FloatTensor<Self>,
        mean: FloatTensor<Self>,
        variance: FloatTensor<Self>,
        saved: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        spec: ConvNormSpec,
    ) -> [FloatTensor<Self>; 4] {
        reference_backward::<Self>(x, weight, gain, shift, mean, variance, saved, grad, spec)
    }

    /// Computes the gradient of the input from that returned by [`ConvNormGradients::conv_norm_backward`].
    fn conv_norm_backward_input(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        gain: FloatTensor<Self>,
        variance: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        spec: ConvNormSpec,
    ) -> FloatTensor<Self> {
        let _ = (gain, variance);
        Self::conv_backward_input(x, weight, grad, spec.conv)
    }
}

/// Runs one after the other; returns the output, and the intermediate values.
fn reference<B: ConvNormBackend>(
    x: FloatTensor<B>,
    weight: FloatTensor<B>,
    gain: FloatTensor<B>,
    shift: FloatTensor<B>,
    mean: FloatTensor<B>,
    variance: FloatTensor<B>,
    spec: ConvNormSpec,
) -> (FloatTensor<B>, FloatTensor<B>) {
    let between = B::conv(x, weight, spec.conv);
    let output = B::normalise(between.clone(), gain, shift, mean, variance, spec.norm());
    (output, between)
}

/// Computes the backward pass of the reference.
fn reference_backward<B: ConvNormGradients>(
    x: FloatTensor<B>,
    weight: FloatTensor<B>,
    gain: FloatTensor<B>,
    shift: FloatTensor<B>,
    mean: FloatTensor<B>,
    variance: FloatTensor<B>,
    between: FloatTensor<B>,
    grad: FloatTensor<B>,
    spec: ConvNormSpec,
) -> [FloatTensor<B>; 4] {
    let norm = spec.norm();
    let [grad, gain, shift] =
        B::normalise_backward(between, gain, shift, mean, variance, grad, norm);
    let weight = B::conv_backward_weight(x, weight, grad.clone(), spec.conv);
    [grad, weight, gain, shift]
}

/// Convolves `x [batch, height, width, in]` with `weight [out, in, taps, taps]` and normalises the outputs. Differentiable in
/// `x`, `weight`, gain and shift.
pub fn conv_norm(
    x: Tensor<4>,
    weight: Tensor<4>,
    fixed: FixedNorm,
    spec: ConvNormSpec,
) -> Tensor<4> {
    let (output, _) = Dispatch::conv_norm(
        x.into_dispatch(),
        weight.into_dispatch(),
        fixed.gain.into_dispatch(),
        fixed.shift.into_dispatch(),
        fixed.mean.into_dispatch(),
        fixed.variance.into_dispatch(),
        spec,
    );
    Tensor::from_dispatch(output)
}

/// Multiplies `x [rows, in]` by `weight [in, out]` and normalises the outputs, like [`conv_norm`].
pub fn linear_norm(
    x: Tensor<2>,
    weight: Tensor<2>,
    fixed: FixedNorm,
    epsilon: f64,
    relu: bool,
) -> Tensor<2> {
    let ([rows, inputs], [_, outputs]) = (x.dims(), weight.dims());
    let weight = weight.transpose().reshape([outputs, inputs, 1, 1]);
    let image = x.reshape([1, 1, rows, inputs]);
    let spec = ConvNormSpec {
        conv: ConvSpec::pointwise(),
        epsilon,
        relu,
    };
    conv_norm(image, weight, fixed, spec).reshape([rows, outputs])
}
