//! Weighted least squares as a differentiable burn operation.
//!
//! There is one problem per image: rows are points, columns are basis functions, and a row weight of 0 marks padding. GPUs
//! solve in f32 on the device; elsewhere, and for other float types, all arithmetic is f64 on the host.

mod autodiff;
#[cfg(feature = "wgpu")]
mod composed;
#[cfg(feature = "wgpu")]
mod cube;
mod host;
#[cfg(test)]
mod tests;

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, backend_extension};
use burn::tensor::Tensor;
use lsdc_core::fit::Solver;

/// Backends with a solver; the default solves on the host.
#[backend_extension(
    Autodiff,
    Flex,
    NdArray: cfg(feature = "ndarray"),
    Cube: cfg(feature = "wgpu"),
)]
pub trait LstsqBackend: Backend {
    /// Solves for `bases [b, n, k]`, `depths [b, n]`, `weights [b, n]`. Returns the solution `[b, k]`, which is differentiable.
    fn lstsq(
        bases: FloatTensor<Self>,
        depths: FloatTensor<Self>,
        weights: FloatTensor<Self>,
        solver: Solver,
    ) -> FloatTensor<Self> {
        Self::lstsq_factor(bases, depths, weights, solver).0
    }

    /// Returns the solution `[b, k]` and K `[b, k, k]` with `K K^T` the pseudo-inverse of the normal matrix; columns of 0 stand
    /// for discarded directions. Not differentiable.
    fn lstsq_factor(
        bases: FloatTensor<Self>,
        depths: FloatTensor<Self>,
        weights: FloatTensor<Self>,
        solver: Solver,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        host::forward::<Self>(bases, depths, weights, solver)
    }
}

/// Gradients of [`LstsqBackend::lstsq`]; the default computes them on the host.
pub trait LstsqGradients: LstsqBackend {
    /// Computes the gradients of `bases` and `depths` from that of the solution.
    fn lstsq_backward(
        bases: FloatTensor<Self>,
        depths: FloatTensor<Self>,
        weights: FloatTensor<Self>,
        solution: FloatTensor<Self>,
        factor: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        solver: Solver,
    ) -> [FloatTensor<Self>; 2] {
        let _ = (solution, factor);
        host::backward::<Self>(bases, depths, weights, grad, solver)
    }
}

/// Minimises `sum_i weights_i (depths_i - bases_i . x)^2` for every image of a batch.
///
/// `bases [batch, points, k]`, `depths` and `weights [batch, points]`; the result is `[batch, k]`. Differentiable in `bases`
/// and `depths`; the weights are constants. A problem without a solution (values that are not finite) yields NaN.
pub fn lstsq(bases: Tensor<3>, depths: Tensor<2>, weights: Tensor<2>, solver: Solver) -> Tensor<2> {
    Tensor::from_dispatch(Dispatch::lstsq(
        bases.into_dispatch(),
        depths.into_dispatch(),
        weights.into_dispatch(),
        solver,
    ))
}

/// Solutions with the factor of their covariance.
#[derive(Clone, Debug)]
pub struct Factored {
    /// Solution of [`lstsq`], `[batch, k]`, detached from the tape.
    pub solution: Tensor<2>,
    /// K `[batch, k, k]`: `K K^T` is the covariance of the solution for points with a noise variance of 1. Columns of 0 stand
    /// for discarded directions.
    pub factor: Tensor<3>,
}

impl Factored {
    /// Solves like [`lstsq`], without differentiation.
    pub fn new(bases: Tensor<3>, depths: Tensor<2>, weights: Tensor<2>, solver: Solver) -> Self {
        let (solution, factor) = Dispatch::lstsq_factor(
            bases.into_dispatch(),
            depths.into_dispatch(),
            weights.into_dispatch(),
            solver,
        );
        Self {
            solution: Tensor::from_dispatch(solution),
            factor: Tensor::from_dispatch(factor),
        }
    }

    /// Returns the number of kept directions of each problem.
    pub fn ranks(&self) -> Vec<usize> {
        let [batch, k, _] = self.factor.dims();
        let largest = self.factor.clone().abs().max_dim(1).reshape([batch * k]);
        let retained: Vec<bool> = largest.into_data().iter::<f32>().map(|v| v > 0.0).collect();
        let count = |some: &[bool]| some.iter().filter(|retained| **retained).count();
        retained.chunks(k.max(1)).map(count).collect()
    }
}
