//! The sum of two multiples of tensors, in one pass over memory and one launch.

#[cfg(feature = "wgpu")]
mod cube;
mod flex;
#[cfg(test)]
mod tests;

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, backend_extension};
use burn::tensor::Tensor;

/// Backends with weighted sums; the default is burn's own operations. Not differentiable.
#[backend_extension(
    Flex,
    NdArray: cfg(feature = "ndarray"),
    Cube: cfg(feature = "wgpu"),
)]
pub trait WeightedSumBackend: Backend {
    /// Returns `a x + b y` for tensors of one shape.
    fn weighted_sum(
        x: FloatTensor<Self>,
        a: f32,
        y: FloatTensor<Self>,
        b: f32,
    ) -> FloatTensor<Self> {
        reference::<Self>(x, a, y, b)
    }
}

fn reference<B: Backend>(x: FloatTensor<B>, a: f32, y: FloatTensor<B>, b: f32) -> FloatTensor<B> {
    let (x, y) = (
        B::float_mul_scalar(x, a.into()),
        B::float_mul_scalar(y, b.into()),
    );
    B::float_add(x, y)
}

/// Returns `a x + b y` for tensors of one shape, not on an autodiff device.
pub fn weighted_sum<const D: usize>(x: Tensor<D>, a: f64, y: Tensor<D>, b: f64) -> Tensor<D> {
    debug_assert_eq!(x.dims(), y.dims());
    let (x, y) = (x.into_dispatch(), y.into_dispatch());
    Tensor::from_dispatch(Dispatch::weighted_sum(x, a as f32, y, b as f32))
}
