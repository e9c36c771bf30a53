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
mod space;
mod spectrum;
pub mod student_t;
#[cfg(test)]
mod tests;
mod window;

pub use affinities::{Affinities, Scene, Smooth};
pub use config::{Changes, FitConfig, FitMethod, PriorKind};
pub use cosines::CosineBasis;
pub use errors::{CalibrationNode, ErrorModel, KNOTS, PIXEL_FEATURES, PixelFeatures, Sample};
pub use fitting::{fit, judge};
pub use joint::{Adjoint, Gradients, JointConfig, Variances};
pub use lambda::{COUNTS, Lambda};
pub use lstsq::{Moments, Problem, Solution, Solver, dot};
pub use noise::LocalNoise;
pub use outcome::{Fit, RANGE, root_mean_square};
pub use points::{Bases, Functions, Points};
pub use prior::{ImageMoments, NoisePrior, Prior};
pub use robust::{InlierPosterior, Loss, Robust};
pub use space::Space;
pub(crate) use window::Window;
