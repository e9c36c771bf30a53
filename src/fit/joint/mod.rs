//! Base functions and a smooth field, fitted together.
//!
//! Depth is modelled as F w + y, y being a field that is smooth but for edges of the image
//! ([`crate::field`]), w the weights of the base functions. Both together minimise
//!
//! > sum over neighbours c_ij (y_i - y_j)^2 + level |y|^2 + data |F_s w + y_s - d|^2 + ridge |w|^2
//!
//! which is universal kriging (Matheron 1969) with a field in place of a covariance function. A
//! local step after a plain fit finds nothing to do, because the base functions were spent on the
//! points; together, the base functions take what the field cannot express. Without base functions
//! it is weighted least squares (Farbman et al. 2008), with a rigid field the paper's fit.

mod autodiff;
mod columns;
mod estimate;
mod host;
mod marginal;
mod problem;
#[cfg(test)]
mod tests;

pub(super) use estimate::{FieldEstimator, FieldFit};
use problem::JointProblem;

use crate::error::{Error, Result};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, backend_extension};
use burn::tensor::{Tensor, s};
use columns::Columns;
use problem::Adjoint;
use serde::{Deserialize, Serialize};
use std::sync::{Arc, Mutex};

/// How base functions and field share the depths.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct JointConfig {
    /// How much a point counts against neighbours that are joined with strength 1.
    pub data: f64,
    /// How much the square of a weight counts, if there is no prior over them.
    pub ridge: f64,
    /// How much the square of the field counts at each pixel: what holds it near 0 far from points.
    pub level: f64,
    /// Up to which frequency waves are part of the field beside base functions: first differences alone
    /// flatten slopes between points. 0: none; F: waves as short as half the width of the image over F.
    pub waves: f64,
    /// How much the square of a wave's weight counts at low frequencies.
    pub bending: f64,
}

impl Default for JointConfig {
    fn default() -> Self {
        Self {
            data: 100.0,
            ridge: 1.0,
            level: 1e-7,
            waves: 0.0,
            // Of 0.2, 0.3, 0.57, 1 and 2 on 60 training frames: the smaller, the better with 500 points
            // (1 % from 1 to 0.2) and the worse with 100 (0.6 %).
            bending: 0.3,
        }
    }
}

impl JointConfig {
    /// For a field alone: without waves, and drawn to nothing but its points.
    #[must_use]
    pub fn alone(self) -> Self {
        Self {
            level: 0.0,
            waves: 0.0,
            ..self
        }
    }

    /// Checks every setting.
    ///
    /// # Errors
    /// The first setting that is out of range.
    pub fn check(&self) -> Result<()> {
        /// Of waves there are about 10 x the square of the frequency.
        const MOST: f64 = 8.0;
        if !(0.0..=MOST).contains(&self.waves) {
            return Err(Error::config(format!(
                "`joint.waves` must be from 0 to {MOST}"
            )));
        }
        if [self.data, self.ridge, self.level, self.bending]
            .iter()
            .all(|v| *v > 0.0 && v.is_finite())
        {
            Ok(())
        } else {
            Err(Error::config(
                "`joint.data`, `joint.ridge`, `joint.level` and `joint.bending` must be above 0",
            ))
        }
    }
}

/// The problems of a batch, as far as they are not tensors.
#[derive(Clone, Debug)]
pub struct Scenes(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    /// Candidate points `y * width + x` of each image.
    pixels: Vec<Vec<u32>>,
    config: JointConfig,
    /// What the way back needs, problem by problem.
    solved: Mutex<Vec<Option<Adjoint>>>,
}

/// Backends that fit jointly.
#[backend_extension(
    Autodiff,
    Flex,
    NdArray: cfg(feature = "ndarray"),
    Cube: cfg(feature = "wgpu"),
)]
pub trait JointBackend: Backend {
    /// `bases [problems, points, k]`, `depths` and `draws [problems, points]`, `edges [images,
    /// height, width, 2]` to weights and field `[problems, k + height width]`.
    fn joint(
        bases: FloatTensor<Self>,
        depths: FloatTensor<Self>,
        draws: FloatTensor<Self>,
        edges: FloatTensor<Self>,
        scenes: Scenes,
    ) -> FloatTensor<Self>;

    /// The gradients of `bases` and `edges` from that of the result.
    fn joint_backward(
        grad: FloatTensor<Self>,
        edges: FloatTensor<Self>,
        scenes: Scenes,
    ) -> (FloatTensor<Self>, FloatTensor<Self>);
}

macro_rules! on_the_host {
    ($($backend:ty)?) => {$(
        impl JointBackend for $backend {
            fn joint(
                bases: FloatTensor<Self>,
                depths: FloatTensor<Self>,
                draws: FloatTensor<Self>,
                edges: FloatTensor<Self>,
                scenes: Scenes,
            ) -> FloatTensor<Self> {
                host::forward::<Self>(bases, depths, draws, edges, &scenes)
            }

            fn joint_backward(
                grad: FloatTensor<Self>,
                edges: FloatTensor<Self>,
                scenes: Scenes,
            ) -> (FloatTensor<Self>, FloatTensor<Self>) {
                host::backward::<Self>(grad, edges, &scenes)
            }
        }
    )?};
}

on_the_host!(burn::backend::Flex);

#[cfg(feature = "ndarray")]
on_the_host!(burn_ndarray::NdArray);

/// What was fitted to each draw.
#[derive(Clone, Debug)]
pub struct JointFit {
    /// Weights `[problems, k]`.
    pub weights: Tensor<2>,
    /// Fields `[problems, height * width]`.
    pub field: Tensor<2>,
}

/// Fits base functions and a field to every draw of points of a batch of images.
///
/// Problem `p` is one of image `p % images`: `bases [problems, points, k]` and `depths [problems,
/// points]` at candidate points, whose pixels `y * width + x` are `pixels[image]`, all different
/// where `draws [problems, points]` is above 0. `edges [images, height, width, 2]` says how
/// strongly each pixel is joined to its right and lower neighbour. Waves are part of the field. Solved
/// on the host in f64; differentiable in `bases` and `edges` by the adjoint equations. A problem without
/// a solution yields NaN.
pub fn joint(
    bases: Tensor<3>,
    depths: Tensor<2>,
    draws: Tensor<2>,
    edges: Tensor<4>,
    pixels: Vec<Vec<u32>>,
    config: JointConfig,
) -> JointFit {
    let [problems, _, k] = bases.dims();
    let [images, height, width, _] = edges.dims();
    let waves = Columns::new(&config, (height, width), &bases);
    let bases = match &waves {
        None => bases,
        Some(waves) => {
            let columns = waves.at(&pixels).repeat_dim(0, problems / images);
            Tensor::cat(vec![bases, columns], 2)
        }
    };
    let scenes = Scenes(Arc::new(Inner {
        pixels,
        config,
        solved: Mutex::default(),
    }));
    let result: Tensor<2> = Tensor::from_dispatch(Dispatch::joint(
        bases.into_dispatch(),
        depths.into_dispatch(),
        draws.into_dispatch(),
        edges.into_dispatch(),
        scenes,
    ));
    let columns = k + waves.as_ref().map_or(0, Columns::count);
    let field = result.clone().slice(s![.., columns..]);
    JointFit {
        weights: result.clone().slice(s![.., ..k]),
        field: match waves {
            None => field,
            Some(waves) => field + waves.maps(result.slice(s![.., k..columns])),
        },
    }
}

#[cfg(feature = "wgpu")]
on_the_host!(burn_cubecl::CubeBackend);
