//! A completion, part by part.

use crate::fault::Fault;
use crate::forms::Form;
use crate::options::{Layer, Options};
use crate::part::Part;
use crate::task::Task;
use lsdc_core::{Completion, DepthMap, Outlier, Scene};
use lsdc_files::Sparse;
use std::time::Duration;

/// More points than this are not judged one by one: it takes several fits.
const JUDGED: usize = 10_000;

/// A completion and what was made of it.
pub(crate) struct Completed {
    pub(crate) points: Sparse,
    pub(crate) completion: Completion,
    pub(crate) depth: Option<DepthMap>,
    /// Pixels that were limited to ten times the range of the points.
    pub(crate) clamped: usize,
    pub(crate) deviations: Option<DepthMap>,
    /// Root mean square of the leave-one-out errors.
    pub(crate) leave_one_out: Option<f64>,
    pub(crate) outliers: Option<Vec<Outlier>>,
    pub(crate) times: Times,
    remarks: Vec<String>,
}

/// How long the parts took that the completion itself does not know of.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Times {
    pub(crate) reading: Duration,
    pub(crate) dense: Duration,
    pub(crate) deviation: Duration,
    pub(crate) judging: Duration,
}

impl Completed {
    /// Fits a scene to points, and makes of it what the form of the answer holds. `remarks` and `reading` are of what
    /// was read before.
    pub(crate) fn new(
        task: &Task,
        scene: &Scene,
        points: Sparse,
        (options, form): (&Options, Form),
        (mut remarks, reading): (Vec<String>, Duration),
    ) -> Result<Self, Fault> {
        let (completion, _) = task.part(Part::Fit, || Ok(scene.complete(&points.points)?))?;
        let mut times = Times {
            reading,
            ..Times::default()
        };
        let mut depth = None;
        if options.wants(Layer::Depth) || form.is_of_depth() {
            let (found, time) = task.part(Part::Depth, || Ok(completion.depth()?))?;
            (depth, times.dense) = (Some(found), time);
        }
        let (low, high) = completion.limits();
        let limited = |map: &DepthMap| {
            let depths = map.values().iter();
            depths.filter(|&&d| d <= low || d >= high).count()
        };
        let mut deviations = None;
        if options.wants(Layer::StandardDeviation) && form.has_deviations() {
            let (found, time) =
                task.part(Part::Deviation, || Ok(completion.standard_deviation()))?;
            times.deviation = time;
            match found {
                Ok(map) => deviations = Some(map),
                Err(lsdc_core::Error::Fit(why @ lsdc_core::FitError::TooFewPoints(_))) => {
                    remarks.push(format!("there are no standard deviations: {why}"));
                }
                Err(error) => return Err(error.into()),
            }
        }
        let (mut leave_one_out, mut outliers) = (None, None);
        if options.wants(Layer::Outliers) && form.names_points() {
            let judge = || {
                let few = completion.report().used <= JUDGED;
                let outliers = few.then(|| completion.outliers()).transpose()?;
                Ok((completion.leave_one_out_error(), outliers))
            };
            let (found, time) = task.part(Part::Judge, judge)?;
            ((leave_one_out, outliers), times.judging) = (found, time);
            if outliers.is_none() {
                remarks.push(format!(
                    "more than {JUDGED} points are not judged one by one"
                ));
            }
        }
        let without = completion.report().without_deviation;
        if without > 0 {
            remarks.push(format!(
                "{without} points have no usable standard deviation; the noise of the fit is assumed for them"
            ));
        }
        Ok(Self {
            clamped: depth.as_ref().map_or(0, limited),
            points,
            completion,
            depth,
            deviations,
            leave_one_out,
            outliers,
            times,
            remarks,
        })
    }

    /// What was assumed or left out and should be checked.
    pub(crate) fn remarks(&self) -> Vec<String> {
        [&self.remarks[..], &self.points.remarks[..]].concat()
    }

    /// The depth, which every form with pixels asks for.
    pub(crate) fn depth(&self) -> Result<&DepthMap, Fault> {
        self.depth.as_ref().ok_or_else(Fault::failed)
    }
}
