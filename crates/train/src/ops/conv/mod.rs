//! 2-D convolution of images `[batch, height, width, channels]` as a burn extension operation: fast kernels for flex and GPUs,
//! burn's own for other backends.

mod autodiff;
#[cfg(feature = "wgpu")]
mod cube;
mod flex;
#[cfg(test)]
mod tests;

pub(super) use flex::biased;
pub use lsdc_kernels::conv::ConvSpec;

use burn::backend::ops::ConvOptions;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, TensorMetadata as _, backend_extension};
use burn::tensor::{Shape, Tensor};

/// Returns whether, with weights `[o, c, k, k]`, each output reads only the pixel at its position.
fn is_pointwise(spec: ConvSpec, weight: &Shape) -> bool {
    weight[2] == 1 && spec == ConvSpec::pointwise()
}

/// Returns burn's options for weights of this shape.
fn options(spec: ConvSpec, weight: &Shape) -> ConvOptions<2> {
    let groups = if spec.depthwise { weight[0] } else { 1 };
    ConvOptions::new(
        [spec.stride; 2],
        [spec.padding; 2],
        [spec.dilation; 2],
        groups,
    )
}

/// Backends with convolution; the defaults are burn's own implementation, the plain reference.
#[backend_extension(
    Autodiff,
    Flex,
    NdArray: cfg(feature = "ndarray"),
    Cube: cfg(feature = "wgpu"),
)]
pub trait ConvBackend: Backend {
    /// Convolves `x [b, h, w, c]` with `weight [o, c, k, k]`, or `[c, 1, k, k]` if depthwise, to `[b, h', w', o]`.
    fn conv(x: FloatTensor<Self>, weight: FloatTensor<Self>, spec: ConvSpec) -> FloatTensor<Self> {
        reference::<Self>(x, weight, spec)
    }
}

/// Gradients of [`ConvBackend::conv`]; the defaults are burn's own implementation.
pub trait ConvGradients: ConvBackend {
    /// Computes the gradient of `x` from that of the output.
    fn conv_backward_input(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        spec: ConvSpec,
    ) -> FloatTensor<Self> {
        reference_input::<Self>(x, weight, grad, spec)
    }

    /// Computes the gradient of `weight` from that of the output.
    fn conv_backward_weight(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        spec: ConvSpec,
    ) -> FloatTensor<Self> {
        reference_weight::<Self>(x, weight, grad, spec)
    }
}

/// Convolves with burn's own operations.
fn reference<B: Backend>(
    x: FloatTensor<B>,
    weight: FloatTensor<B>,
    spec: ConvSpec,
) -> FloatTensor<B> {
    if is_pointwise(spec, &weight.shape()) {
        let rows = B::float_matmul(
            rows::<B>(x.clone()),
            B::float_swap_dims(matrix::<B>(weight), 0, 1),
        );
        return images::<B>(rows, &x.shape());
    }
    let options = options(spec, &weight.shape());
    let output = B::conv2d(channels_first::<B>(x), weight, None, options);
    channels_last::<B>(output)
}

/// Computes the gradient of the input with burn's own operations.
fn reference_input<B: Backend>(
    x: FloatTensor<B>,
    weight: FloatTensor<B>,
    grad: FloatTensor<B>,
    spec: ConvSpec,
) -> FloatTensor<B> {
    if is_pointwise(spec, &weight.shape()) {
        let rows = B::float_matmul(rows::<B>(grad), matrix::<B>(weight));
        return images::<B>(rows, &x.shape());
    }
    let (x, grad) = (channels_first::<B>(x), channels_first::<B>(grad));
    let options = options(spec, &weight.shape());
    channels_last::<B>(B::conv2d_x_backward(x, weight, grad, options))
}

/// Computes the gradient of the weights with burn's own operations.
fn reference_weight<B: Backend>(
    x: FloatTensor<B>,
    weight: FloatTensor<B>,
    grad: FloatTensor<B>,
    spec: ConvSpec,
) -> FloatTensor<B> {
    if is_pointwise(spec, &weight.shape()) {
        let grad = B::float_swap_dims(rows::<B>(grad), 0, 1);
        let product = B::float_matmul(grad, rows::<B>(x));
        return B::float_reshape(product, weight.shape());
    }
    let (x, grad) = (channels_first::<B>(x), channels_first::<B>(grad));
    let options = options(spec, &weight.shape());
    B::conv2d_weight_backward(x, weight, grad, options)
}

/// Reshapes `[b, h, w, c]` to rows `[b h w, c]`.
fn rows<B: Backend>(x: FloatTensor<B>) -> FloatTensor<B> {
    let shape = x.shape();
    B::float_reshape(x, Shape::new([shape[0] * shape[1] * shape[2], shape[3]]))
}

/// Reshapes rows to images of the size of `like`.
fn images<B: Backend>(rows: FloatTensor<B>, like: &Shape) -> FloatTensor<B> {
    let channels = rows.shape()[1];
    B::float_reshape(rows, Shape::new([like[0], like[1], like[2], channels]))
}

/// Reshapes weights `[o, c, 1, 1]` to `[o, c]`.
fn matrix<B: Backend>(weight: FloatTensor<B>) -> FloatTensor<B> {
    let shape = weight.shape();
    B::float_reshape(weight, Shape::new([shape[0], shape[1]]))
}

/// Permutes `[b, h, w, c]` to `[b, c, h, w]`.
fn channels_first<B: Backend>(x: FloatTensor<B>) -> FloatTensor<B> {
    B::float_permute(x, &[0, 3, 1, 2])
}

/// Permutes `[b, c, h, w]` to `[b, h, w, c]`.
fn channels_last<B: Backend>(x: FloatTensor<B>) -> FloatTensor<B> {
    B::float_permute(x, &[0, 2, 3, 1])
}

/// Returns the product of `x [rows, in]` and `weight [in, out]`.
pub fn linear(x: Tensor<2>, weight: Tensor<2>) -> Tensor<2> {
    let ([rows, inputs], [_, outputs]) = (x.dims(), weight.dims());
    let weight = weight.transpose().reshape([outputs, inputs, 1, 1]);
    let image = x.reshape([1, 1, rows, inputs]);
    conv2d(image, weight, ConvSpec::pointwise()).reshape([rows, outputs])
}

/// Convolves `x [batch, height, width, in]` with `weight [out, in, taps, taps]`, or `[in, 1, taps, taps]` if depthwise.
pub fn conv2d(x: Tensor<4>, weight: Tensor<4>, spec: ConvSpec) -> Tensor<4> {
    Tensor::from_dispatch(Dispatch::conv(
        x.into_dispatch(),
        weight.into_dispatch(),
        spec,
    ))
}
