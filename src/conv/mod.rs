//! 2-D convolution of images `[batch, height, width, channels]` as a burn extension op: fast
//! kernels for flex, burn's own for other backends.

mod autodiff;
mod flex;
mod layer;
mod shape;
#[cfg(test)]
mod tests;
mod unfold;
mod winograd;

pub(crate) use layer::Layer;

use burn::backend::ops::ConvOptions;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, backend_extension};
use burn::tensor::Tensor;

/// Stride, padding and dilation, equal in both directions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConvSpec {
    /// Distance between outputs, in input pixels.
    pub stride: usize,
    /// Zeros on each side.
    pub padding: usize,
    /// Distance between taps, in input pixels.
    pub dilation: usize,
}

impl ConvSpec {
    /// 3x3 at stride 1 with the size kept.
    pub fn same(dilation: usize) -> Self {
        Self {
            stride: 1,
            padding: dilation,
            dilation,
        }
    }

    /// 3x3 at stride 2: half the size, rounded up.
    pub fn halving() -> Self {
        Self {
            stride: 2,
            padding: 1,
            dilation: 1,
        }
    }

    /// 1x1.
    pub fn pointwise() -> Self {
        Self {
            stride: 1,
            padding: 0,
            dilation: 1,
        }
    }

    /// The output's length along an axis of `length` for a kernel of `taps`; 0 if none fits.
    pub fn output(self, length: usize, taps: usize) -> usize {
        let reach = self.dilation * (taps - 1) + 1;
        (length + 2 * self.padding)
            .checked_sub(reach)
            .map_or(0, |room| room / self.stride + 1)
    }

    fn options(self) -> ConvOptions<2> {
        ConvOptions::new([self.stride; 2], [self.padding; 2], [self.dilation; 2], 1)
    }
}

/// Backends that convolve; the defaults are burn's own implementation, the plain reference.
#[backend_extension(
    Autodiff,
    Flex,
    NdArray: cfg(feature = "ndarray"),
    Cube: cfg(feature = "wgpu"),
)]
pub trait ConvBackend: Backend {
    /// `x [b, h, w, c]` with `weight [o, c, k, k]` to `[b, h', w', o]`.
    fn conv(x: FloatTensor<Self>, weight: FloatTensor<Self>, spec: ConvSpec) -> FloatTensor<Self> {
        let output = Self::conv2d(channels_first::<Self>(x), weight, None, spec.options());
        channels_last::<Self>(output)
    }

    /// The gradient of `x` from that of the output.
    fn conv_backward_input(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        spec: ConvSpec,
    ) -> FloatTensor<Self> {
        let (x, grad) = (channels_first::<Self>(x), channels_first::<Self>(grad));
        channels_last::<Self>(Self::conv2d_x_backward(x, weight, grad, spec.options()))
    }

    /// The gradient of `weight` from that of the output.
    fn conv_backward_weight(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        spec: ConvSpec,
    ) -> FloatTensor<Self> {
        let (x, grad) = (channels_first::<Self>(x), channels_first::<Self>(grad));
        Self::conv2d_weight_backward(x, weight, grad, spec.options())
    }
}

/// `[b, h, w, c]` as `[b, c, h, w]`.
fn channels_first<B: Backend>(x: FloatTensor<B>) -> FloatTensor<B> {
    B::float_permute(x, &[0, 3, 1, 2])
}

/// `[b, c, h, w]` as `[b, h, w, c]`.
fn channels_last<B: Backend>(x: FloatTensor<B>) -> FloatTensor<B> {
    B::float_permute(x, &[0, 2, 3, 1])
}

#[cfg(feature = "ndarray")]
impl ConvBackend for burn_ndarray::NdArray {}

#[cfg(feature = "wgpu")]
impl ConvBackend for burn_cubecl::CubeBackend {}

/// Convolves `x [batch, height, width, in]` with `weight [out, in, taps, taps]`.
pub fn conv2d(x: Tensor<4>, weight: Tensor<4>, spec: ConvSpec) -> Tensor<4> {
    Tensor::from_dispatch(Dispatch::conv(
        x.into_dispatch(),
        weight.into_dispatch(),
        spec,
    ))
}
