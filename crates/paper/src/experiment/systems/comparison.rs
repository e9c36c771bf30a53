//! All that is measured of the systems.

use super::clock::Clock;
use super::conditions::Conditions;
use super::entrants::Field;
use crate::experiment::ExperimentContext;
use lsdc_files::error::Result;
use std::rc::Rc;

/// The systems with what they are measured under, and how long they take.
pub(in crate::experiment) struct Systems<'a> {
    pub(super) field: Rc<Field<'a>>,
    pub(super) conditions: Conditions<'a>,
    pub(super) clocks: Vec<Clock<'a>>,
}

impl<'a> Systems<'a> {
    pub(in crate::experiment) fn new(context: &'a ExperimentContext) -> Result<Self> {
        let field = Rc::new(Field::new(context)?);
        Ok(Self {
            conditions: Conditions::new(&field)?,
            clocks: Clock::all(&field),
            field,
        })
    }
}
