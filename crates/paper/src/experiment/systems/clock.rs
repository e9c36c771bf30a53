//! The trial that is timed: one of those that take part.

use super::entrants::{ComparedSystem, Field, OURS};
use crate::experiment::cost::{SIZES, Subject, Timed};
use crate::experiment::trial::{Progress, Trial};
use lsdc_eval::sampling::Size;
use lsdc_files::error::Result;
use std::rc::Rc;

/// The size of the frame.
pub(super) const SIZE: Size = SIZES[0];

/// The time of one of them, once it is trained.
pub(super) struct Clock<'a> {
    field: Rc<Field<'a>>,
    /// Which of the systems; none: `lsdc`.
    number: Option<usize>,
    name: String,
}

impl<'a> Clock<'a> {
    /// Of `lsdc`, and of all systems.
    pub(super) fn all(field: &Rc<Field<'a>>) -> Vec<Self> {
        let clocks = (0..=field.entrants.len()).map(|number| Self {
            field: field.clone(),
            number: number.checked_sub(1),
            name: format!("systems-time-{number}"),
        });
        clocks.collect()
    }

    /// Which of the systems; none: `lsdc`.
    pub(super) fn entrant(&self) -> Option<&ComparedSystem<'a>> {
        self.number.map(|number| &self.field.entrants[number])
    }

    /// Milliseconds, once they are known.
    pub(super) fn total(&self) -> Result<Option<f64>> {
        self.timed()?.map(|timed| timed.total()).transpose()
    }

    fn timed(&self) -> Result<Option<Timed<'a>>> {
        let (label, subject) = match self.entrant() {
            None => (OURS.to_owned(), Subject::Ours { full: false }),
            Some(entrant) => {
                let Some(predictor) = entrant.predictor()? else {
                    return Ok(None);
                };
                (predictor.trained().hash.clone(), Subject::System(predictor))
            }
        };
        Ok(Some(Timed {
            context: self.field.context,
            name: self.name.clone(),
            label,
            subject,
            size: SIZE,
        }))
    }
}

impl Trial for Clock<'_> {
    fn name(&self) -> &str {
        &self.name
    }

    fn kept(&self) -> Result<usize> {
        self.timed()?.map_or(Ok(0), |timed| timed.kept())
    }

    fn run(&self, progress: &mut Progress<'_>) -> Result<()> {
        if let Some(timed) = self.timed()? {
            return timed.run(progress);
        }
        let _ = progress(0.0);
        Ok(())
    }
}
