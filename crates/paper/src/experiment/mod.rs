//! The paper's experiments. Each consists of parts that are measured separately and stored, so that an interrupted experiment
//! can be resumed with identical results.

mod ablation;
mod benchmark;
mod context;
mod cost;
mod diode;
mod frames;
mod kernels;
mod knowledge;
mod noise;
mod points;
mod published;
mod resolution;
mod scale;
mod systems;
mod tables;
#[cfg(test)]
mod tests;
mod trial;
mod uncertainty;

pub use context::{ExperimentContext, Recipe, SystemRecipe};

use lsdc_eval::report::Section;
use lsdc_files::error::{Error, Result};
use std::ops::ControlFlow;
use std::path::Path;
use std::time::{Duration, Instant};
use trial::{Study, Trial};

/// An experiment of the paper (Fang et al., section 4).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Experiment {
    /// Table 1: comparison of errors with other methods, at 500 points.
    Benchmark,
    /// Ablation of the number of basis functions and of the positional encoding; trains each network on an equal budget.
    Ablation,
    /// Errors against the number of points.
    Points,
    /// Errors against the scale of the depths.
    Scale,
    /// Errors with noisy points, with and without robust losses.
    Noise,
    /// Calibration of the predicted standard deviations.
    Uncertainty,
    /// The value of trained weights: errors of several weights for few and many points.
    Knowledge,
    /// Pictures of basis functions, and of the pixels that they make similar.
    Kernels,
    /// Depth at three times the resolution of the image.
    Resolution,
    /// Table 4: evaluation of the same weights on DIODE.
    Diode,
    /// Table 5: parameters and times.
    Cost,
    /// The systems compared in the paper, trained and evaluated under equal conditions.
    Systems,
}

impl Experiment {
    /// All experiments, in the order of the page.
    pub const ALL: [Self; 12] = [
        Self::Benchmark,
        Self::Ablation,
        Self::Points,
        Self::Scale,
        Self::Noise,
        Self::Uncertainty,
        Self::Knowledge,
        Self::Kernels,
        Self::Resolution,
        Self::Diode,
        Self::Cost,
        Self::Systems,
    ];

    /// Returns the name on the command line and in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Benchmark => "benchmark",
            Self::Ablation => "ablation",
            Self::Points => "points",
            Self::Scale => "scale",
            Self::Noise => "noise",
            Self::Uncertainty => "uncertainty",
            Self::Knowledge => "knowledge",
            Self::Kernels => "kernels",
            Self::Resolution => "resolution",
            Self::Diode => "diode",
            Self::Cost => "cost",
            Self::Systems => "systems",
        }
    }

    /// Prepares the parts of the experiment.
    fn prepare<'a>(self, context: &'a ExperimentContext) -> Result<Box<dyn Study + 'a>> {
        Ok(match self {
            Self::Benchmark => Box::new(benchmark::Benchmark::new(context)),
            Self::Ablation => Box::new(ablation::Ablation::new(context)?),
            Self::Points => Box::new(points::PointsStudy::new(context)),
            Self::Scale => Box::new(scale::ScaleStudy::new(context)),
            Self::Noise => Box::new(noise::NoiseStudy::new(context)),
            Self::Uncertainty => Box::new(uncertainty::Uncertainty::new(context)),
            Self::Knowledge => Box::new(knowledge::Knowledge::new(context)),
            Self::Kernels => Box::new(kernels::KernelsStudy::new(context)),
            Self::Resolution => Box::new(resolution::Resolution::new(context)),
            Self::Diode => Box::new(diode::Diode::new(context)?),
            Self::Cost => Box::new(cost::Cost::new(context)),
            Self::Systems => Box::new(systems::Systems::new(context)?),
        })
    }
}

/// Events while experiments run.
#[derive(Clone, Copy, Debug)]
pub enum ExperimentEvent<'a> {
    /// This many results of an earlier run of the same experiments are reused.
    Resumed(usize),
    /// A part runs briefly, to estimate its time.
    Estimating {
        /// Number of parts before this one.
        done: usize,
        /// Total number of parts.
        total: usize,
        /// Name of the part.
        trial: &'a str,
    },
    /// Estimate of the remaining time.
    Estimated(Duration),
    /// A part makes progress.
    Progress {
        /// Estimated time of the work done.
        done: Duration,
        /// Estimated total time.
        total: Duration,
        /// Name of the part.
        trial: &'a str,
    },
}

/// Runs experiments, writes the results of each to the folder of `context`, and returns them; `None` if `report` interrupted
/// them, in which case the same call resumes.
///
/// # Errors
/// A part fails: frames cannot be read, the folder contains records of another experiment, or it cannot be written.
pub fn run(
    experiments: &[Experiment],
    context: &ExperimentContext,
    mut report: impl FnMut(ExperimentEvent<'_>) -> ControlFlow<()>,
) -> Result<Option<Vec<Section>>> {
    for folder in [&context.folder, &context.trials(), &context.runs()] {
        std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
    }
    let studies: Vec<Box<dyn Study>> = experiments
        .iter()
        .map(|experiment| experiment.prepare(context))
        .collect::<Result<_>>()?;
    let trials: Vec<&dyn Trial> = studies.iter().flat_map(|study| study.trials()).collect();

    let mut resumed = 0;
    for trial in &trials {
        resumed += trial.stored()?;
    }
    if resumed > 0 && report(ExperimentEvent::Resumed(resumed)).is_break() {
        return Ok(None);
    }

    let mut left = Vec::with_capacity(trials.len());
    for (done, trial) in trials.iter().enumerate() {
        let estimating = ExperimentEvent::Estimating {
            done,
            total: trials.len(),
            trial: trial.name(),
        };
        if report(estimating).is_break() {
            return Ok(None);
        }
        left.push(estimate(*trial, context.probe_time)?);
    }
    let total = left.iter().sum();
    if report(ExperimentEvent::Estimated(total)).is_break() {
        return Ok(None);
    }
    let mut before = Duration::ZERO;
    for (trial, &left) in trials.iter().zip(&left) {
        let mut start = None;
        let mut stopped = false;
        trial.run(&mut |share| {
            let start = *start.get_or_insert(share);
            let part = (share - start) / (1.0 - start).max(f64::EPSILON);
            let flow = report(ExperimentEvent::Progress {
                done: before + left.mul_f64(part.clamp(0.0, 1.0)),
                total,
                trial: trial.name(),
            });
            stopped |= flow.is_break();
            flow
        })?;
        if stopped {
            return Ok(None);
        }
        before += left;
    }
    let sections: Vec<Section> = studies
        .iter()
        .map(|study| {
            let mut section = study.section()?;
            for trial in study.trials() {
                section.add_failures(trial.failures()?);
            }
            Ok(section)
        })
        .collect::<Result<_>>()?;
    for section in &sections {
        section.write(&context.folder)?;
    }
    Ok(Some(sections))
}

/// Runs a part briefly, and estimates its remaining time. The results of the trial are kept.
fn estimate(trial: &dyn Trial, limit: Duration) -> Result<Duration> {
    let mut first: Option<(Instant, f64)> = None;
    let mut left = Duration::ZERO;
    trial.run(&mut |share| {
        let (started, start) = *first.get_or_insert((Instant::now(), share));
        let elapsed = started.elapsed();
        if share > start {
            left = elapsed.mul_f64((1.0 - share).max(0.0) / (share - start));
        }
        if share > start && elapsed >= limit {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    })?;
    Ok(left)
}

/// Removes the results of an earlier run of these experiments.
///
/// # Errors
/// The records cannot be removed.
pub fn remove_results(folder: &Path) -> Result<()> {
    for name in ["cells", "runs"] {
        let path = folder.join(name);
        if path.exists() {
            std::fs::remove_dir_all(&path).map_err(|e| Error::write(&path, e))?;
        }
    }
    Ok(())
}
