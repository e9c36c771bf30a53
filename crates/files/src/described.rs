//! A completion in numbers, by the names that `lsdc complete --json` and the service share: metres, and counts of pixels.

use crate::Cloud;
use lsdc_core::{Completion, DepthMap, Outlier};
use serde::Serialize;

/// A depth map.
#[derive(Clone, Debug, Serialize)]
pub struct DescribedDepth {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// The nearest depth.
    pub lowest: f32,
    /// The farthest.
    pub highest: f32,
    /// Pixels whose depth was limited to ten times the range of the points.
    #[serde(skip_serializing_if = "is_zero")]
    pub clamped: usize,
}

impl DescribedDepth {
    /// Nothing of a map without depths.
    pub fn new(map: &DepthMap, clamped: usize) -> Option<Self> {
        let (lowest, highest) = map.range()?;
        Some(Self {
            width: map.width(),
            height: map.height(),
            lowest,
            highest,
            clamped,
        })
    }
}

/// What a cloud has of the pixels.
#[derive(Clone, Debug, Serialize)]
pub struct DescribedCloud {
    /// Points.
    pub points: usize,
    /// Pixels that are left out because they are too uncertain.
    pub uncertain: usize,
    /// Pixels that are left out because the lens does not look there.
    pub unseen: usize,
    /// Pixels that are left out because they lie between the surfaces at a depth edge.
    pub flying: usize,
    /// Pixels that share a voxel with an earlier one.
    pub merged: usize,
}

impl From<&Cloud> for DescribedCloud {
    fn from(cloud: &Cloud) -> Self {
        Self {
            points: cloud.points.len(),
            uncertain: cloud.uncertain,
            unseen: cloud.unseen,
            flying: cloud.flying,
            merged: cloud.merged,
        }
    }
}

/// A fit.
#[derive(Clone, Debug, Serialize)]
pub struct DescribedFit {
    /// What was fitted.
    pub method: &'static str,
    /// Root mean square at the points.
    pub residual: f64,
    /// The same without outliers, if points were judged.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub residual_inliers: Option<f64>,
    /// Root mean square of the leave-one-out errors (PRESS), if points were judged.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub leave_one_out: Option<f64>,
    /// The same without outliers, if points were judged: the error to expect between the points.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub leave_one_out_inliers: Option<f64>,
    /// Points that were found to be outliers, if points were judged.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub outliers: Option<usize>,
    /// The number of standard deviations that hold 95 % of errors, if standard deviations are asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub deviations_of_95: Option<f64>,
    /// Points that were smoothed by their standard deviations before the fit.
    #[serde(skip_serializing_if = "is_zero")]
    pub smoothed: usize,
    /// Pixels in holes of dense depths at which basis functions contradicted the depths around.
    #[serde(skip_serializing_if = "is_zero")]
    pub limited: usize,
    /// Directions that the points determine.
    pub rank: usize,
    /// Basis functions, of which that many directions at most are determined.
    pub functions: usize,
    /// How far the guide was trusted, if there was one; 0: not at all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub guide_trust: Option<f64>,
    /// How far the map goes from the joint fit, 0, to the median of this, the field alone and the surface of the points, 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub median_share: Option<f64>,
}

impl DescribedFit {
    /// Of a completion, with what its points were judged to be; `deviations`: standard deviations are asked for.
    pub fn new(
        completion: &Completion,
        leave_one_out: Option<f64>,
        outliers: Option<&[Outlier]>,
        deviations: bool,
    ) -> Self {
        let report = completion.report();
        let judged = leave_one_out.and(outliers);
        let of_inliers = judged.and_then(|outliers| without(outliers, completion.leave_one_out()));
        let deviations_of_95 = deviations.then(|| completion.interval(0.95).ok());
        Self {
            method: report.method.name(),
            residual: report.residual,
            residual_inliers: outliers
                .and_then(|outliers| without(outliers, completion.residuals())),
            leave_one_out,
            leave_one_out_inliers: of_inliers,
            outliers: outliers.map(<[Outlier]>::len),
            deviations_of_95: deviations_of_95.flatten(),
            smoothed: report.smoothed,
            limited: report.limited,
            rank: report.rank,
            functions: report.functions,
            guide_trust: report.guide_trust,
            median_share: report.median_share,
        }
    }
}

/// Root mean square of the errors of the points that are no outliers and were used; nothing if there is none.
fn without(outliers: &[Outlier], mut errors: Vec<f64>) -> Option<f64> {
    for outlier in outliers {
        errors[outlier.index] = f64::NAN;
    }
    errors.retain(|error| !error.is_nan());
    let sum: f64 = errors.iter().map(|error| error * error).sum();
    (!errors.is_empty()).then(|| (sum / errors.len() as f64).sqrt())
}

#[allow(clippy::trivially_copy_pass_by_ref)]
fn is_zero(count: &usize) -> bool {
    *count == 0
}
