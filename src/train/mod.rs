//! Training: losses, steps, checkpoints, the run.

mod checkpoint;
mod config;
mod learner;
mod log;
mod loss;
mod run;
mod schedule;

pub use config::TrainConfig;
pub use learner::{Learner, Step};
pub use loss::{LossConfig, Losses, losses};
pub use run::{Event, Outcome, Trainer};
pub use schedule::Schedule;
