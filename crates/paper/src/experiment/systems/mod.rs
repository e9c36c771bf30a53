//! The systems compared in the paper, next to `lsdc`: trained on the same frames with the same number of steps and images, then
//! evaluated with the same points. Conditions: fewer or more points, other patterns, scaled or noisy depths, other cameras, and
//! a higher resolution than that of the image.

mod compared;
mod condition;
mod conditions;
mod page;
mod pictures;
mod tables;
#[cfg(test)]
pub(super) mod tests;
mod timing;
mod training;

use super::trial::Trial;
use super::{ExperimentContext, Study};
use compared::{ComparedSystem, ComparedSystems};
use conditions::Conditions;
use lsdc_eval::report::Section;
use lsdc_files::error::Result;
use std::rc::Rc;
use timing::TimedSystem;

/// The systems, with the conditions and timings of the comparison.
pub(super) struct Systems<'a> {
    compared: Rc<ComparedSystems<'a>>,
    conditions: Conditions<'a>,
    timings: Vec<TimedSystem<'a>>,
}

impl<'a> Systems<'a> {
    pub(super) fn new(context: &'a ExperimentContext) -> Result<Self> {
        let compared = Rc::new(ComparedSystems::new(context)?);
        Ok(Self {
            conditions: Conditions::new(&compared)?,
            timings: TimedSystem::all(&compared),
            compared,
        })
    }
}

impl Study for Systems<'_> {
    fn trials(&self) -> Vec<&dyn Trial> {
        let mut trials: Vec<&dyn Trial> = Vec::new();
        for system in &self.compared.systems {
            if let ComparedSystem::Trained(trial) = system {
                trials.push(trial);
            }
        }
        trials.extend(
            self.compared
                .same_budget
                .as_ref()
                .map(|same| same as &dyn Trial),
        );
        trials.extend(
            self.conditions
                .all()
                .map(|condition| condition as &dyn Trial),
        );
        trials.extend(self.timings.iter().map(|timing| timing as &dyn Trial));
        trials
    }

    fn section(&self) -> Result<Section> {
        page::section(self)
    }
}
