//! Distillation: training a network with the outputs of a trained one, its teacher.
//!
//! [`dataset`] adds the teacher's depths to training frames, using [`relative_depth`] for photographs; [`losses`] compare other
//! outputs of its network.

mod dataset;
mod losses;
mod relative_depth;

pub(super) use dataset::DistilledDataset;
pub use dataset::{DistillTarget, TeacherConfig};
pub use losses::TeacherOutput;
