//! From basis functions and sparse depths to weights: the least-squares fit (paper section 3.3).

mod affinities;
mod blocks;
mod config;
mod cosines;
mod errors;
mod estimate;
mod estimator;
mod fitting;
mod guided;
mod joint;
mod lambda;
mod leave_one_out;
mod lstsq;
mod measured;
mod medians;
mod noise;
mod outcome;
mod points;
mod prior;
mod reduced;
mod robust;
mod shrink;
mod spectrum;
pub mod student_t;
#[cfg(test)]
mod tests;
mod window;

pub use affinities::{Affinities, FieldGeometry, SmoothField};
pub use config::{Changes, FitConfig, FitMethod, PriorKind};
pub use cosines::CosineBasis;
pub use errors::{
    CALIBRATION_NODES, CalibrationNode, ErrorModel, ErrorSample, PIXEL_FEATURES, PixelFeatures,
};
pub use fitting::{fit, inlier_posteriors};
pub use joint::{Adjoint, Gradients, JointConfig, Variances};
pub use lambda::{LAMBDA_COUNTS, Lambda};
pub use lstsq::{Moments, Problem, Solution, Solver, dot};
pub(crate) use medians::median;
pub use noise::LocalNoise;
pub use outcome::{Fit, root_mean_square};
pub use points::{BasisValues, EvaluateBasis, FitPoints};
pub use prior::{ImageMoments, NoisePrior, Prior};
pub use robust::{InlierPosterior, Loss, Robust};
pub(crate) use window::Window;
