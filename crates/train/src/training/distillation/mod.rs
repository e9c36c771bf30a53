//! Distillation: what a network learns from a trained one, its teacher.
//!
//! [`dataset`] gives training frames the teacher's depths, those of photographs by [`relative_depth`]; [`losses`] compare with what its network finds beside depths.

mod dataset;
mod losses;
mod relative_depth;

pub(super) use dataset::DistilledDataset;
pub use dataset::{DistillTarget, TeacherConfig};
pub use losses::TeacherOutput;
