//! Distillation: what a network learns from a trained one, its teacher.
//!
//! [`dataset`] gives training frames the teacher's depths; [`losses`] compare with what its network finds beside depths.

mod dataset;
mod losses;

pub(super) use dataset::DistilledDataset;
pub use dataset::{DistillTarget, TeacherConfig};
pub use losses::TeacherOutput;
