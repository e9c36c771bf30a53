//! Batch normalisation, optionally followed by ReLU, as a burn extension operation: fast paths for flex and GPUs, burn's own
//! operations for other backends.

mod autodiff;
#[cfg(feature = "wgpu")]
mod cube;
mod flex;
#[cfg(test)]
mod tests;

pub(super) use flex::vector;

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, TensorMetadata as _, backend_extension};
use burn::tensor::{Shape, Tensor};

/// Settings of a normalisation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NormSpec {
    /// Added to the variance.
    pub epsilon: f64,
    /// Whether a ReLU follows.
    pub relu: bool,
    /// Whether the statistics are those of the input itself, with gradients through them.
    pub own: bool,
}

/// Backends with normalisation; the defaults are the plain reference.
#[backend_extension(
    Autodiff,
    Flex,
    NdArray: cfg(feature = "ndarray"),
    Cube: cfg(feature = "wgpu"),
)]
pub trait NormBackend: Backend {
    /// Returns mean and biased variance of each channel of `x [.., channels]`; not differentiable.
    fn moments(x: FloatTensor<Self>) -> (FloatTensor<Self>, FloatTensor<Self>) {
        reference_moments::<Self>(x)
    }

    /// Computes `(x - mean) / sqrt(variance + epsilon) * gain + shift` per channel of `x [.., channels]`, then the ReLU if
    /// `relu`.
    fn normalise(
        x: FloatTensor<Self>,
        gain: FloatTensor<Self>,
        shift: FloatTensor<Self>,
        mean: FloatTensor<Self>,
        variance: FloatTensor<Self>,
        spec: NormSpec,
    ) -> FloatTensor<Self> {
        reference::<Self>(x, gain, shift, mean, variance, spec)
    }
}

/// Gradients of [`NormBackend::normalise`]; the default is the plain reference.
pub trait NormGradients: NormBackend {
    /// Computes the gradients of `x`, `gain` and `shift` from that of the output.
    fn normalise_backward(
        x: FloatTensor<Self>,
        gain: FloatTensor<Self>,
        shift: FloatTensor<Self>,
        mean: FloatTensor<Self>,
        variance: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        spec: NormSpec,
    ) -> [FloatTensor<Self>; 3] {
        reference_backward::<Self>(x, gain, shift, mean, variance, grad, spec)
    }
}

/// Reshapes `[.., channels]` to `[rows, channels]`, as burn's batch normalisation expects.
fn rows_of<B: Backend>(x: FloatTensor<B>) -> FloatTensor<B> {
    let shape = x.shape();
    let channels = shape.last().copied().unwrap_or(1);
    B::float_reshape(
        x,
        Shape::new([shape.num_elements() / channels.max(1), channels]),
    )
}

/// Computes the forward pass with burn's own operations.
fn reference<B: Backend>(
    x: FloatTensor<B>,
    gain: FloatTensor<B>,
    shift: FloatTensor<B>,
    mean: FloatTensor<B>,
    variance: FloatTensor<B>,
    spec: NormSpec,
) -> FloatTensor<B> {
    let shape = x.shape();
    let output = B::batch_norm(rows_of::<B>(x), gain, shift, mean, variance, spec.epsilon);
    let output = if spec.relu { B::relu(output) } else { output };
    B::float_reshape(output, shape)
}

/// Computes mean and variance with burn's own operations.
fn reference_moments<B: Backend>(x: FloatTensor<B>) -> (FloatTensor<B>, FloatTensor<B>) {
    let x = rows_of::<B>(x);
    let channels = Shape::new([x.shape()[1]]);
    let (device, dtype) = (x.device(), x.dtype().into());
    let ones = B::float_ones(channels.clone(), &device, dtype);
    let zeros = B::float_zeros(channels, &device, dtype);
    let result = B::batch_norm_train(x, ones, zeros, 1e-5);
    (result.mean, result.variance)
}

/// Computes the backward pass with burn's own operations.
fn reference_backward<B: Backend>(
    x: FloatTensor<B>,
    gain: FloatTensor<B>,
    shift: FloatTensor<B>,
    mean: FloatTensor<B>,
    variance: FloatTensor<B>,
    grad: FloatTensor<B>,
    spec: NormSpec,
) -> [FloatTensor<B>; 3] {
    let shape = x.shape();
    let (x, grad) = (rows_of::<B>(x), rows_of::<B>(grad));
    let norm = |x, shift| {
        B::batch_norm(
            x,
            gain.clone(),
            shift,
            mean.clone(),
            variance.clone(),
            spec.epsilon,
        )
    };
    let grad = if spec.relu {
        B::relu_backward(B::relu(norm(x.clone(), shift)), grad)
    } else {
        grad
    };
    let back = B::batch_norm_train_backward(
        x,
        gain.clone(),
        mean.clone(),
        variance.clone(),
        spec.epsilon,
        grad.clone(),
    );
    if spec.own {
        let x_grad = B::float_reshape(back.x_grad, shape);
        return [x_grad, back.gamma_grad, back.beta_grad];
    }
    // With fixed statistics, the gradient of the input is only multiplied by the slope.
    let zeros = |t: &FloatTensor<B>| B::float_zeros(t.shape(), &t.device(), t.dtype().into());
    let through = B::batch_norm(
        grad,
        gain.clone(),
        zeros(&gain),
        zeros(&mean),
        variance.clone(),
        spec.epsilon,
    );
    let x_grad = B::float_reshape(through, shape);
    [x_grad, back.gamma_grad, back.beta_grad]
}

/// Returns mean and biased variance `[channels]` of `x [.., channels]`; not differentiable.
pub fn moments<const D: usize>(x: Tensor<D>) -> (Tensor<1>, Tensor<1>) {
    let (mean, variance) = Dispatch::moments(x.into_dispatch());
    (Tensor::from_dispatch(mean), Tensor::from_dispatch(variance))
}

/// Normalises `x [.., channels]`; differentiable in `x`, `gain` and `shift`.
pub fn normalise<const D: usize>(
    x: Tensor<D>,
    gain: Tensor<1>,
    shift: Tensor<1>,
    mean: Tensor<1>,
    variance: Tensor<1>,
    spec: NormSpec,
) -> Tensor<D> {
    Tensor::from_dispatch(Dispatch::normalise(
        x.into_dispatch(),
        gain.into_dispatch(),
        shift.into_dispatch(),
        mean.into_dispatch(),
        variance.into_dispatch(),
        spec,
    ))
}
