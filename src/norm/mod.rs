//! Batch normalisation in training, with the ReLU that mostly follows it, as one burn extension
//! op: a fast path for flex, burn's own operations for other backends.

mod autodiff;
mod flex;
mod layout;

use burn::backend::ops::{ActivationOps as _, ModuleOps as _};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, backend_extension};
use burn::tensor::Tensor;

/// Backends that normalise; the defaults are the plain reference.
#[backend_extension(
    Autodiff,
    Flex,
    NdArray: cfg(feature = "ndarray"),
    Cube: cfg(feature = "wgpu"),
)]
pub trait NormBackend: Backend {
    /// Normalises `x [batch, channels, ..]` by its own statistics over all axes but the second,
    /// then scales, shifts and, with `relu`, cuts off below 0. Returns output, mean and variance.
    fn batch_norm_relu(
        x: FloatTensor<Self>,
        gain: FloatTensor<Self>,
        shift: FloatTensor<Self>,
        epsilon: f64,
        relu: bool,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>) {
        let result = Self::batch_norm_train(x, gain, shift, epsilon);
        let output = if relu { Self::relu(result.output) } else { result.output };
        (output, result.mean, result.variance)
    }

    /// The gradients of `x`, `gain` and `shift` from that of the output.
    #[allow(clippy::too_many_arguments)]
    fn batch_norm_relu_backward(
        x: FloatTensor<Self>,
        gain: FloatTensor<Self>,
        shift: FloatTensor<Self>,
        mean: FloatTensor<Self>,
        variance: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        epsilon: f64,
        relu: bool,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>) {
        let grad = if relu {
            let output = Self::batch_norm_train(x.clone(), gain.clone(), shift, epsilon).output;
            Self::relu_backward(Self::relu(output), grad)
        } else {
            grad
        };
        let back = Self::batch_norm_train_backward(x, gain, mean, variance, epsilon, grad);
        (back.x_grad, back.gamma_grad, back.beta_grad)
    }
}

#[cfg(feature = "ndarray")]
impl NormBackend for burn_ndarray::NdArray {}

#[cfg(feature = "wgpu")]
impl NormBackend for burn_cubecl::CubeBackend {}

/// Output `[batch, channels, ..]`, and the mean and biased variance of each channel.
pub fn batch_norm_relu<const D: usize>(
    x: Tensor<D>,
    gain: Tensor<1>,
    shift: Tensor<1>,
    epsilon: f64,
    relu: bool,
) -> (Tensor<D>, Tensor<1>, Tensor<1>) {
    let (output, mean, variance) = Dispatch::batch_norm_relu(
        x.into_dispatch(),
        gain.into_dispatch(),
        shift.into_dispatch(),
        epsilon,
        relu,
    );
    (
        Tensor::from_dispatch(output),
        Tensor::from_dispatch(mean),
        Tensor::from_dispatch(variance),
    )
}
