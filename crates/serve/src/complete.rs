//! A completion, stage by stage.

use crate::computation::{Computation, Stage};
use crate::fault::Fault;
use crate::media_type::MediaType;
use crate::options::{Options, OutputLayer};
use lsdc_core::{Completion, DepthMap, FitError, Outlier, Scene};
use lsdc_files::{MOST_TESTED, Sparse, clamped_pixels};
use std::time::Duration;

/// A completion and what was made of it.
pub(crate) struct CompletionResult {
    pub(crate) points: Sparse,
    pub(crate) completion: Completion,
    pub(crate) depth: Option<DepthMap>,
    /// Pixels limited because they are far outside the range of the points.
    pub(crate) clamped: usize,
    pub(crate) deviations: Option<DepthMap>,
    /// Root mean square of the leave-one-out errors.
    pub(crate) leave_one_out: Option<f64>,
    pub(crate) outliers: Option<Vec<Outlier>>,
    pub(crate) times: StageTimes,
    remarks: Vec<String>,
}

/// The times of the stages that the report of the completion does not include.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct StageTimes {
    pub(crate) reading: Duration,
    pub(crate) dense: Duration,
    pub(crate) deviation: Duration,
    pub(crate) outlier_test: Duration,
}

impl CompletionResult {
    /// Fits a scene to points, and computes what answers of this media type hold. `remarks` and `reading` are those of
    /// reading the request.
    pub(crate) fn new(
        computation: &Computation,
        scene: &Scene,
        points: Sparse,
        (options, media_type): (&Options, MediaType),
        (mut remarks, reading): (Vec<String>, Duration),
    ) -> Result<Self, Fault> {
        let fit = || Ok(scene.complete(&points.points)?);
        let (completion, _) = computation.stage(Stage::Fit, fit)?;
        let mut times = StageTimes {
            reading,
            ..StageTimes::default()
        };
        let mut depth = None;
        if options.wants(OutputLayer::Depth) || media_type.needs_depth() {
            let (found, time) = computation.stage(Stage::Depth, || Ok(completion.depth()?))?;
            (depth, times.dense) = (Some(found), time);
        }
        let mut deviations = None;
        if options.wants(OutputLayer::StandardDeviation) && media_type.has_deviations() {
            let deviation = || Ok(completion.standard_deviation());
            let (found, time) = computation.stage(Stage::Deviation, deviation)?;
            times.deviation = time;
            match found {
                Ok(map) => deviations = Some(map),
                Err(lsdc_core::Error::Fit(why @ FitError::TooFewPoints(_))) => {
                    remarks.push(format!("there are no standard deviations: {why}"));
                }
                Err(error) => return Err(error.into()),
            }
        }
        let (mut leave_one_out, mut outliers) = (None, None);
        if options.wants(OutputLayer::Outliers) && media_type.has_outliers() {
            let test = || {
                let few = completion.report().used <= MOST_TESTED;
                let outliers = few.then(|| completion.outliers()).transpose()?;
                Ok((completion.leave_one_out_error(), outliers))
            };
            let (found, time) = computation.stage(Stage::OutlierTest, test)?;
            ((leave_one_out, outliers), times.outlier_test) = (found, time);
            if outliers.is_none() {
                remarks.push(format!(
                    "more than {MOST_TESTED} points are not judged one by one"
                ));
            }
        }
        let without = completion.report().without_deviation;
        if without > 0 {
            remarks.push(format!(
                "{without} points have no usable standard deviation; the noise of the fit is assumed for them"
            ));
        }
        let clamped = |map| clamped_pixels(&completion, map);
        Ok(Self {
            clamped: depth.as_ref().map_or(0, clamped),
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

    /// Warnings: assumptions to check, and what was left out.
    pub(crate) fn remarks(&self) -> Vec<String> {
        [&self.remarks[..], &self.points.remarks[..]].concat()
    }

    /// The depth, which every media type with pixels needs.
    pub(crate) fn depth(&self) -> Result<&DepthMap, Fault> {
        self.depth.as_ref().ok_or_else(Fault::failed)
    }
}
