//! Joint fit of basis functions and a smooth field, as a differentiable burn operation. The equations are those of
//! `lsdc_core::fit`.

mod autodiff;
mod columns;
#[cfg(feature = "wgpu")]
mod cube;
mod host;
mod problems;
#[cfg(test)]
mod tests;

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, backend_extension};
use burn::tensor::{Tensor, s};
use columns::CosineColumns;
use lsdc_core::fit::{FitConfig, PriorKind};
pub use problems::Problems;

/// Backends with the joint fit; the default fits on the host.
#[backend_extension(
    Autodiff,
    Flex,
    NdArray: cfg(feature = "ndarray"),
    Cube: cfg(feature = "wgpu"),
)]
pub trait JointBackend: Backend {
    /// Fits `bases [problems, points, k]`, `depths` and `draws [problems, points]` and `affinities [images, height, width, 2]`.
    /// Returns weights and field `[problems, k + height width]`.
    fn joint(
        bases: FloatTensor<Self>,
        depths: FloatTensor<Self>,
        draws: FloatTensor<Self>,
        affinities: FloatTensor<Self>,
        problems: Problems,
    ) -> FloatTensor<Self> {
        host::forward::<Self>(bases, depths, draws, affinities, &problems)
    }
}

/// Gradients of [`JointBackend::joint`]; the default computes them on the host.
pub trait JointGradients: JointBackend {
    /// Computes the gradients of `bases` and `affinities` from that of the result.
    fn joint_backward(
        grad: FloatTensor<Self>,
        affinities: FloatTensor<Self>,
        problems: Problems,
    ) -> [FloatTensor<Self>; 2] {
        host::backward::<Self>(grad, affinities, &problems)
    }
}

/// The fits to all draws.
#[derive(Clone, Debug)]
pub struct JointFit {
    /// Weights `[problems, k]`.
    pub weights: Tensor<2>,
    /// Fields `[problems, height * width]`.
    pub field: Tensor<2>,
}

/// Fits basis functions and a field to every draw of points of a batch of images.
///
/// Problem `p` belongs to image `p % images`. `bases [problems, points, k]` and `depths [problems, points]` are given at
/// candidate points, whose pixels `y * width + x` are `pixels[image]`, all different where `draws [problems, points]` is
/// positive. `affinities [images, height, width, 2]` join each pixel to its right and lower neighbour. Cosines are part of the
/// field. Solved on the host in f64; differentiable in `bases` and `affinities` by the adjoint equations. With the flat prior
/// the weight of the first basis function is free, otherwise all have the same ridge. A problem without a solution yields NaN.
pub fn joint(
    bases: Tensor<3>,
    depths: Tensor<2>,
    draws: Tensor<2>,
    affinities: Tensor<4>,
    pixels: Vec<Vec<u32>>,
    fit: &FitConfig,
) -> JointFit {
    let config = fit.joint;
    let [count, _, k] = bases.dims();
    let [images, height, width, _] = affinities.dims();
    let cosines = CosineColumns::new(&config, (height, width), &bases);
    let bases = match &cosines {
        None => bases,
        Some(cosines) => {
            let columns = cosines.at(&pixels).repeat_dim(0, count / images);
            Tensor::cat(vec![bases, columns], 2)
        }
    };
    let free = usize::from(fit.prior == PriorKind::Flat);
    let problems = Problems::new(pixels, config, free);
    let result: Tensor<2> = Tensor::from_dispatch(Dispatch::joint(
        bases.into_dispatch(),
        depths.into_dispatch(),
        draws.into_dispatch(),
        affinities.into_dispatch(),
        problems,
    ));
    let columns = k + cosines.as_ref().map_or(0, CosineColumns::count);
    let field = result.clone().slice(s![.., columns..]);
    JointFit {
        weights: result.clone().slice(s![.., ..k]),
        field: match cosines {
            None => field,
            Some(cosines) => field + cosines.maps(result.slice(s![.., k..columns])),
        },
    }
}
