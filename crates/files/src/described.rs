//! A completion in numbers, by the names that `lsdc complete --json` and the service share: metres, and counts of pixels.

use crate::error::Result;
use crate::{ColoredCloud, Sparse, Unit, png_unit, raised_in_png};
use lsdc_core::{Completion, DepthMap, Outlier};
use serde::{Serialize, Serializer};

/// More points than this are tested for outliers only on request: the test takes several fits.
pub const MOST_TESTED: usize = 10_000;

/// The points of a completion.
#[derive(Clone, Debug, Serialize)]
pub struct DescribedPoints {
    /// Points that were fitted.
    pub used: usize,
    /// NaN, infinite or not positive.
    pub ignored: usize,
    /// Outside the image.
    pub outside: usize,
    /// Behind others.
    pub hidden: usize,
    /// The unit that their depths were stored in.
    pub unit: String,
    /// Whether the unit is a guess.
    pub unit_guessed: bool,
}

impl DescribedPoints {
    /// The counts of reading the points, and of their fit if one was made.
    pub fn new(points: &Sparse, completion: Option<&Completion>) -> Self {
        let report = completion.map(Completion::report);
        Self {
            used: report.map_or(points.points.len(), |report| report.used),
            ignored: points.ignored + report.map_or(0, |report| report.invalid),
            outside: points.outside + report.map_or(0, |report| report.outside),
            hidden: points.hidden,
            unit: points.unit.to_string(),
            unit_guessed: points.guessed,
        }
    }
}

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

/// Counts the pixels of a map of a completion whose depth was limited to ten times the range of the points; at
/// [`Quality::Best`](lsdc_core::Quality::Best), in either fit.
pub fn clamped_pixels(completion: &Completion, map: &DepthMap) -> usize {
    completion.clamped_pixels(map)
}

/// A 16-bit PNG of depths.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct DescribedPng {
    /// Its unit; in JSON, how many units make a metre.
    #[serde(rename = "png_units_per_metre", serialize_with = "per_metre")]
    pub unit: Unit,
    /// Pixels that hold one unit, as they are nearer than half of it.
    #[serde(rename = "png_raised", skip_serializing_if = "is_zero")]
    pub raised: usize,
}

impl DescribedPng {
    /// The PNG of a map.
    ///
    /// # Errors
    /// A depth that does not fit.
    pub fn new(map: &DepthMap) -> Result<Self> {
        let unit = png_unit(map)?;
        let raised = raised_in_png(map, unit.metres());
        Ok(Self { unit, raised })
    }
}

fn per_metre<S: Serializer>(unit: &Unit, serializer: S) -> std::result::Result<S::Ok, S::Error> {
    serializer.serialize_f64(1.0 / unit.metres())
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

impl From<&ColoredCloud> for DescribedCloud {
    fn from(cloud: &ColoredCloud) -> Self {
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
