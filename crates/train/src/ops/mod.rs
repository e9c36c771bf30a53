//! Differentiable operations on tensors of any backend: burn extensions of the kernels and fits used by completion.

mod autodiff;
pub mod conv;
pub mod conv_norm;
#[cfg(feature = "wgpu")]
mod gpu;
mod host;
pub mod interpolate;
mod joint;
mod lstsq;
pub mod norm;
pub mod pack;
pub mod propagate;
mod reweighted;
pub mod weighted_sum;

pub use joint::{JointBackend, JointFit, JointGradients, Problems, joint};
pub use lstsq::{Factored, LstsqBackend, LstsqGradients, lstsq};
pub use reweighted::{Reweighting, RobustGradient, reweighted};

/// Implements operations for a backend by their default methods.
macro_rules! by_default {
    ($backend:ty: $($operation:path),+ $(,)?) => {
        $(impl $operation for $backend {})+
    };
}

by_default!(
    burn::backend::Flex:
    joint::JointBackend,
    joint::JointGradients,
    lstsq::LstsqBackend,
    lstsq::LstsqGradients,
);

#[cfg(feature = "ndarray")]
by_default!(
    burn_ndarray::NdArray:
    conv::ConvBackend,
    conv::ConvGradients,
    conv_norm::ConvNormBackend,
    conv_norm::ConvNormGradients,
    interpolate::InterpolateBackend,
    interpolate::InterpolateGradients,
    joint::JointBackend,
    joint::JointGradients,
    lstsq::LstsqBackend,
    lstsq::LstsqGradients,
    norm::NormBackend,
    norm::NormGradients,
    pack::PackBackend,
    propagate::PropagateBackend,
    propagate::PropagateGradients,
    weighted_sum::WeightedSumBackend,
);

#[cfg(feature = "wgpu")]
by_default!(
    burn_cubecl::CubeBackend:
    conv_norm::ConvNormBackend,
    conv_norm::ConvNormGradients,
    propagate::PropagateBackend,
    propagate::PropagateGradients,
);
