//! Training: losses, steps, checkpoints, the run, and what is learned once it is over.

mod affinities;
mod average;
mod calibrate;
mod checkpoint;
mod compare;
mod config;
mod efficientnet;
mod foresight;
mod imitation;
mod learner;
mod log;
mod loss;
mod muon;
mod parallel;
mod publish;
mod record;
mod run;
mod scenes;
mod schedule;
mod setup;
mod slower;
mod step;
mod teacher;

pub use calibrate::{Held, calibrate, learn_errors};
pub use config::{BackboneTraining, Division, OptimiserKind, Part, TrainConfig};
pub use foresight::{Foresight, NUMBERS};
pub use imitation::Shown;
pub use learner::{Fitting, Learner, Objective, Predicting};
pub use loss::{LossConfig, Losses, losses};
pub use publish::{SCORES_NOTE, TRAINING_NOTE};
pub use run::{Event, Outcome, Trainer};
pub use scenes::Scenes;
pub use schedule::Schedule;
pub use step::Step;
pub use teacher::{Lesson, TeacherConfig};
