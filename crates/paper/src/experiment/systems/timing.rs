//! A trial that times `lsdc` or a system.

use super::compared::{ComparedSystem, ComparedSystems, OURS};
use crate::experiment::cost::{SIZES, Timed, TimedSubject};
use crate::experiment::trial::{Progress, Trial};
use lsdc_eval::sampling::Size;
use lsdc_files::error::Result;
use std::rc::Rc;

/// Size of the frame.
pub(super) const SIZE: Size = SIZES[0];

/// The timing of `lsdc` or a system, after it is trained.
pub(super) struct TimedSystem<'a> {
    compared: Rc<ComparedSystems<'a>>,
    /// Index of the system; `None` for `lsdc`.
    number: Option<usize>,
    name: String,
}

impl<'a> TimedSystem<'a> {
    /// Returns the timings of `lsdc` and of all systems.
    pub(super) fn all(compared: &Rc<ComparedSystems<'a>>) -> Vec<Self> {
        let timings = (0..=compared.systems.len()).map(|number| Self {
            compared: compared.clone(),
            number: number.checked_sub(1),
            name: format!("systems-time-{number}"),
        });
        timings.collect()
    }

    /// Returns the system; `None` for `lsdc`.
    pub(super) fn system(&self) -> Option<&ComparedSystem<'a>> {
        self.number.map(|number| &self.compared.systems[number])
    }

    /// Returns the total time in milliseconds; `None` before it is measured.
    pub(super) fn total(&self) -> Result<Option<f64>> {
        self.timed()?.map(|timed| timed.total()).transpose()
    }

    fn timed(&self) -> Result<Option<Timed<'a>>> {
        let (label, subject) = match self.system() {
            None => (OURS.to_owned(), TimedSubject::Ours { full: false }),
            Some(system) => {
                let Some(predictor) = system.predictor()? else {
                    return Ok(None);
                };
                (
                    predictor.trained().hash.clone(),
                    TimedSubject::System(predictor),
                )
            }
        };
        Ok(Some(Timed {
            context: self.compared.context,
            name: self.name.clone(),
            label,
            subject,
            size: SIZE,
        }))
    }
}

impl Trial for TimedSystem<'_> {
    fn name(&self) -> &str {
        &self.name
    }

    fn stored(&self) -> Result<usize> {
        self.timed()?.map_or(Ok(0), |timed| timed.stored())
    }

    fn run(&self, progress: &mut Progress<'_>) -> Result<()> {
        if let Some(timed) = self.timed()? {
            return timed.run(progress);
        }
        let _ = progress(0.0);
        Ok(())
    }
}
