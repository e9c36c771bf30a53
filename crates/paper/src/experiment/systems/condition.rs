//! A trial that evaluates all systems under one condition.

use super::compared::{ComparedSystems, SAME_BUDGET};
use crate::experiment::resolution::{SMALL, enlarged};
use crate::experiment::trial::{Measured, Progress, Trial};
use lsdc_eval::evaluation::{Candidate, Enlargement};
use lsdc_eval::metrics::Scores;
use lsdc_eval::predict::{Classic, Method};
use lsdc_eval::report::{Failure, Section};
use lsdc_files::error::Result;
use std::rc::Rc;

/// Methods without training, evaluated for comparison.
const UNTRAINED: [Method; 2] = [
    Method::Classic(Classic::Steering),
    Method::Classic(Classic::Linear),
];

/// A function that modifies the evaluation on the protocol of the context.
type Change<'a> = Box<dyn Fn(Measured<'a>) -> Measured<'a> + 'a>;

/// All systems under one condition, after they are trained.
pub(super) struct Condition<'a> {
    compared: Rc<ComparedSystems<'a>>,
    name: String,
    pub(super) label: String,
    change: Change<'a>,
    /// Whether the depth has a higher resolution than the image.
    sharp: bool,
}

impl<'a> Condition<'a> {
    pub(super) fn new(
        compared: &Rc<ComparedSystems<'a>>,
        name: &str,
        label: impl Into<String>,
        change: impl Fn(Measured<'a>) -> Measured<'a> + 'a,
    ) -> Self {
        Self {
            compared: compared.clone(),
            name: format!("systems-{name}"),
            label: label.into(),
            change: Box::new(change),
            sharp: false,
        }
    }

    /// Evaluates depth at a higher resolution than the image.
    pub(super) fn sharp(mut self) -> Self {
        self.sharp = true;
        self
    }

    /// Returns a method of this program.
    fn method(&self, method: Method) -> (String, Candidate) {
        let name = method.name().to_owned();
        match (self.sharp, method) {
            (false, method) => (name, Candidate::Method(method)),
            (true, Method::Lsdc) => enlarged(name, method, Enlargement::Bases),
            (true, method) => enlarged(name, method, Enlargement::Bilinear),
        }
    }

    /// Returns the evaluations of `lsdc` and the systems, and that of our network with the same training.
    fn parts(&self) -> Result<Vec<Measured<'a>>> {
        let Some(predictors) = self.compared.predictors()? else {
            return Ok(Vec::new());
        };
        let from = self.sharp.then_some(SMALL);
        let systems = predictors
            .into_iter()
            .map(|(name, predictor)| (name, predictor.candidate(from)));
        let candidates = std::iter::once(self.method(Method::Lsdc))
            .chain(systems)
            .chain(UNTRAINED.map(|method| self.method(method)));
        let all = Measured::new(self.compared.context, &self.name).candidates(candidates.collect());
        let mut parts = vec![(self.change)(all)];
        if let Some(same) = &self.compared.same_budget {
            let (_, own) = self.method(Method::Lsdc);
            let trial = same
                .measured_as(&format!("{}-same", self.name))?
                .candidates(vec![(SAME_BUDGET.to_owned(), own)]);
            parts.push((self.change)(trial));
        }
        Ok(parts)
    }

    /// Returns each method's name and mean scores: `lsdc`, our network with the same training, the systems, the untrained
    /// methods.
    pub(super) fn means(&self) -> Result<Vec<(String, Scores)>> {
        let mut parts = self.parts()?.into_iter();
        let mut means = match parts.next() {
            None => Vec::new(),
            Some(all) => all.means()?,
        };
        for part in parts {
            for mean in part.means()?.into_iter().rev() {
                means.insert(1, mean);
            }
        }
        Ok(means)
    }

    /// Adds a picture of the frame with the median RMSE of `lsdc`.
    pub(super) fn show(&self, section: &mut Section, name: &str, caption: &str) -> Result<()> {
        match self.parts()?.first() {
            Some(all) => all.show_named(section, name, caption),
            None => Ok(()),
        }
    }
}

impl Trial for Condition<'_> {
    fn name(&self) -> &str {
        &self.name
    }

    fn stored(&self) -> Result<usize> {
        self.parts()?.iter().map(Trial::stored).sum()
    }

    fn run(&self, progress: &mut Progress<'_>) -> Result<()> {
        let parts = self.parts()?;
        if parts.is_empty() {
            // The systems are not trained yet.
            let _ = progress(0.0);
        }
        let count = parts.len() as f64;
        let mut stopped = false;
        for (number, part) in parts.iter().enumerate() {
            part.run(&mut |share| {
                let flow = progress((number as f64 + share) / count);
                stopped |= flow.is_break();
                flow
            })?;
            if stopped {
                break;
            }
        }
        Ok(())
    }

    fn failures(&self) -> Result<Vec<Failure>> {
        let parts = self.parts()?;
        let failures = parts.iter().map(Trial::failures);
        Ok(failures.collect::<Result<Vec<_>>>()?.concat())
    }
}
