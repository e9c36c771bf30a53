//! Spatial propagation (Cheng et al. 2018) as a burn extension operation: a fast path for flex, burn's own operations for other
//! backends.

mod autodiff;
mod flex;
#[cfg(test)]
mod tests;

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, TensorMetadata as _, backend_extension};
use burn::tensor::ops::PadMode;
use burn::tensor::{Shape, Slice, Tensor};
pub use lsdc_kernels::propagate::{NEIGHBOURS, OFFSETS};

/// Backends with propagation; the defaults are the plain reference.
#[backend_extension(
    Autodiff,
    Flex,
    NdArray: cfg(feature = "ndarray"),
    Cube: cfg(feature = "wgpu"),
)]
pub trait PropagateBackend: Backend {
    /// Propagates `start [n, h, w]` with `weights [n, h, w, 8]`; after each step, pixels with `known [n, h, w]` above 0 are
    /// reset to these values.
    fn spread(
        weights: FloatTensor<Self>,
        start: FloatTensor<Self>,
        known: FloatTensor<Self>,
        steps: usize,
    ) -> FloatTensor<Self> {
        Plain::<Self>::new(weights, start, known).run(steps).1
    }
}

/// Gradients of [`PropagateBackend::spread`]; the default is the plain reference.
pub trait PropagateGradients: PropagateBackend {
    /// Computes the gradients of `weights` and `start` from that of the result.
    fn spread_backward(
        weights: FloatTensor<Self>,
        start: FloatTensor<Self>,
        known: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        steps: usize,
    ) -> [FloatTensor<Self>; 2] {
        Plain::<Self>::new(weights, start, known).backward(grad, steps)
    }
}

/// The maps of a propagation with burn's own operations.
struct Plain<B: Backend> {
    /// Weight of each neighbour, `[n, h, w]`.
    weights: Vec<FloatTensor<B>>,
    /// Weight of the start: 1 minus the sum of the weights.
    start_weight: FloatTensor<B>,
    start: FloatTensor<B>,
    known: FloatTensor<B>,
    /// 1 at unknown pixels, otherwise 0.
    unknown: FloatTensor<B>,
}

impl<B: Backend> Plain<B> {
    fn new(weights: FloatTensor<B>, start: FloatTensor<B>, known: FloatTensor<B>) -> Self {
        let shape = start.shape();
        let of = |k: usize| {
            let k = k as isize;
            let all = Slice::full();
            let slices = [all, all, all, Slice::new(k, Some(k + 1), 1)];
            B::float_reshape(B::float_slice(weights.clone(), &slices), shape.clone())
        };
        let weights: Vec<_> = (0..NEIGHBOURS).map(of).collect();
        let ones = B::float_ones(shape, &start.device(), start.dtype().into());
        let sum = |sum, weight: &FloatTensor<B>| B::float_sub(sum, weight.clone());
        let start_weight = weights.iter().fold(ones.clone(), sum);
        let unknown = B::float_sub(ones, B::float_sign(known.clone()));
        Self {
            weights,
            start_weight,
            start,
            known,
            unknown,
        }
    }

    /// Returns the map shifted by this many rows and columns; 0 outside.
    fn shifted(map: FloatTensor<B>, (rows, columns): (isize, isize)) -> FloatTensor<B> {
        let shape = map.shape();
        let padded = B::float_pad(map, &[(0, 0), (1, 1), (1, 1)], PadMode::Constant(0.0));
        let along = |axis: usize, offset: isize| {
            let first = 1 + offset;
            Slice::new(first, Some(first + shape[axis] as isize), 1)
        };
        B::float_slice(padded, &[Slice::full(), along(1, rows), along(2, columns)])
    }

    /// Returns the maps before each step, and the final one.
    fn run(&self, steps: usize) -> (Vec<FloatTensor<B>>, FloatTensor<B>) {
        let mut states = Vec::with_capacity(steps);
        let mut map = self.start.clone();
        for _ in 0..steps {
            states.push(map.clone());
            let own = B::float_mul(self.start_weight.clone(), self.start.clone());
            let pairs = self.weights.iter().zip(OFFSETS);
            let sum = pairs.fold(own, |sum, (weight, offset)| {
                let neighbour = Self::shifted(map.clone(), offset);
                B::float_add(sum, B::float_mul(weight.clone(), neighbour))
            });
            map = B::float_add(B::float_mul(sum, self.unknown.clone()), self.known.clone());
        }
        (states, map)
    }

    fn backward(&self, grad: FloatTensor<B>, steps: usize) -> [FloatTensor<B>; 2] {
        let (states, _) = self.run(steps);
        let shape = self.start.shape();
        let zeros = || B::float_zeros(shape.clone(), &grad.device(), grad.dtype().into());
        let mut of_weights: Vec<_> = (0..NEIGHBOURS).map(|_| zeros()).collect();
        let mut of_start = zeros();
        let mut gradient = grad.clone();
        for state in states.into_iter().rev() {
            let own = B::float_mul(gradient, self.unknown.clone());
            of_start = B::float_add(
                of_start,
                B::float_mul(own.clone(), self.start_weight.clone()),
            );
            gradient = zeros();
            for (k, (rows, columns)) in OFFSETS.into_iter().enumerate() {
                let neighbour = Self::shifted(state.clone(), (rows, columns));
                let apart = B::float_sub(neighbour, self.start.clone());
                let change = B::float_mul(own.clone(), apart);
                of_weights[k] = B::float_add(of_weights[k].clone(), change);
                let back = B::float_mul(self.weights[k].clone(), own.clone());
                gradient = B::float_add(gradient, Self::shifted(back, (-rows, -columns)));
            }
        }
        let flat = Shape::new([shape[0], shape[1], shape[2], 1]);
        let of_weights = of_weights
            .into_iter()
            .map(|map| B::float_reshape(map, flat.clone()));
        let of_weights = B::float_cat(of_weights.collect(), 3);
        [of_weights, B::float_add(of_start, gradient)]
    }
}

/// Propagates `start [n, height, width]` in `steps` steps with `weights [n, height, width, 8]` of the neighbours in
/// [`OFFSETS`]; the start has the weight 1 minus their sum. After each step, pixels with `known` above 0 are reset to these
/// values. Differentiable in `weights` and `start`.
pub fn propagate(
    weights: Tensor<4>,
    start: Tensor<3>,
    known: Tensor<3>,
    steps: usize,
) -> Tensor<3> {
    Tensor::from_dispatch(Dispatch::spread(
        weights.into_dispatch(),
        start.into_dispatch(),
        known.into_dispatch(),
        steps,
    ))
}
