//! The systems that the paper compares itself with, beside `lsdc`: trained on the same frames with the same number of
//! steps and images, then measured with the same points, fewer, more, elsewhere, scaled and wrong ones, on other
//! cameras, and at a higher resolution than that of the image.

mod clock;
mod comparison;
mod conditions;
mod entrants;
mod narrow;
mod page;
mod pictures;
mod side;
mod tables;
#[cfg(test)]
pub(super) mod tests;
mod training;

use super::Study;
use super::trial::Trial;
pub(super) use comparison::Systems;
use entrants::ComparedSystem;
use lsdc_eval::report::Section;
use lsdc_files::error::Result;

impl Study for Systems<'_> {
    fn trials(&self) -> Vec<&dyn Trial> {
        let mut trials: Vec<&dyn Trial> = Vec::new();
        for entrant in &self.field.entrants {
            if let ComparedSystem::Trained(trial) = entrant {
                trials.push(trial);
            }
        }
        trials.extend(self.field.same.as_ref().map(|same| same as &dyn Trial));
        trials.extend(self.conditions.sides().map(|side| side as &dyn Trial));
        trials.extend(self.clocks.iter().map(|clock| clock as &dyn Trial));
        trials
    }

    fn section(&self) -> Result<Section> {
        page::section(self)
    }
}
