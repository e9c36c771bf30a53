//! Statistics of a completion, under the names that `lsdc complete --json` and the service share. Lengths are in metres.

use crate::error::Result;
use crate::{ColoredCloud, Sparse, Unit, png_unit, raised_in_png};
use lsdc_core::{Completion, DepthMap, Outlier};
use serde::{Serialize, Serializer};

/// Above this number of points, outlier tests need to be requested, because a test takes several fits.
pub const MOST_TESTED: usize = 10_000;

/// Counts of the points of a completion.
#[derive(Clone, Debug, Serialize)]
pub struct DescribedPoints {
    /// Number of fitted points.
    pub used: usize,
    /// Number of points whose depth is NaN, infinite or not positive.
    pub ignored: usize,
    /// Number of points outside the image.
    pub outside: usize,
    /// Number of points hidden behind others.
    pub hidden: usize,
    /// Unit of the stored depths.
    pub unit: String,
    /// Whether the unit is a guess.
    pub unit_guessed: bool,
}

impl DescribedPoints {
    /// Takes the counts from reading the points, and from their fit if one was made.
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

/// Statistics of a depth map.
#[derive(Clone, Debug, Serialize)]
pub struct DescribedDepth {
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// Nearest depth.
    pub lowest: f32,
    /// Farthest depth.
    pub highest: f32,
    /// Number of pixels limited because they are far outside the range of the points.
    #[serde(skip_serializing_if = "is_zero")]
    pub clamped: usize,
}

impl DescribedDepth {
    /// Returns the statistics of a map; `None` if it has no depths.
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

/// Counts the pixels of a completed map that were limited because they are far outside the range of the points; at
/// [`Quality::Best`](lsdc_core::Quality::Best), in either fit.
pub fn clamped_pixels(completion: &Completion, map: &DepthMap) -> usize {
    completion.clamped_pixels(map)
}

/// Statistics of a 16-bit depth PNG.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct DescribedPng {
    /// Unit of the PNG; in JSON, the number of units per metre.
    #[serde(rename = "png_units_per_metre", serialize_with = "per_metre")]
    pub unit: Unit,
    /// Number of pixels that are raised to one unit because their depth is less than half of it.
    #[serde(rename = "png_raised", skip_serializing_if = "is_zero")]
    pub raised: usize,
}

impl DescribedPng {
    /// Chooses the unit of a map and counts raised pixels.
    ///
    /// # Errors
    /// A depth does not fit.
    pub fn new(map: &DepthMap) -> Result<Self> {
        let unit = png_unit(map)?;
        let raised = raised_in_png(map, unit.metres());
        Ok(Self { unit, raised })
    }
}

fn per_metre<S: Serializer>(unit: &Unit, serializer: S) -> std::result::Result<S::Ok, S::Error> {
    serializer.serialize_f64(1.0 / unit.metres())
}

/// Pixel counts of a cloud.
#[derive(Clone, Debug, Serialize)]
pub struct DescribedCloud {
    /// Number of points.
    pub points: usize,
    /// Number of pixels left out as too uncertain.
    pub uncertain: usize,
    /// Number of pixels left out because the lens has no ray for them.
    pub unseen: usize,
    /// Number of pixels left out because they are between the surfaces at a depth edge.
    pub flying: usize,
    /// Number of pixels that share a voxel with an earlier one.
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

/// Statistics of a fit.
#[derive(Clone, Debug, Serialize)]
pub struct DescribedFit {
    /// Fitted model.
    pub method: &'static str,
    /// Root mean square residual at the points.
    pub residual: f64,
    /// `residual` without outliers, if outliers were tested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub residual_inliers: Option<f64>,
    /// Root mean square of the leave-one-out errors (PRESS), if outliers were tested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub leave_one_out: Option<f64>,
    /// `leave_one_out` without outliers, if outliers were tested: the error to expect between the points.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub leave_one_out_inliers: Option<f64>,
    /// Outlier count, if outliers were tested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub outliers: Option<usize>,
    /// Number of standard deviations that cover 95 % of errors, if standard deviations were requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub deviations_of_95: Option<f64>,
    /// Number of pixels of the image that show sky that no point measured, if standard deviations were requested: they are at
    /// least the depth there.
    #[serde(skip_serializing_if = "is_zero")]
    pub sky: usize,
    /// Number of points that were smoothed by their standard deviations before the fit.
    #[serde(skip_serializing_if = "is_zero")]
    pub smoothed: usize,
    /// Number of pixels in holes of dense depths at which basis functions contradicted the surrounding depths.
    #[serde(skip_serializing_if = "is_zero")]
    pub limited: usize,
    /// Number of directions that the points determine.
    pub rank: usize,
    /// Number of basis functions, an upper bound of `rank`.
    pub functions: usize,
    /// Prior standard deviation of the weights of the guide's functions, in units of the scene's scale, if there was a guide; 0
    /// if the points do not support it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub guide_trust: Option<f64>,
    /// Position of the map between the joint fit (0) and the median of the joint fit, the field alone and the surface of
    /// the points (1).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub median_share: Option<f64>,
}

impl DescribedFit {
    /// Collects the statistics of a completion and of its outlier test. `deviations` is whether standard deviations were
    /// requested.
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
            sky: if deviations {
                completion.sky_pixels()
            } else {
                0
            },
            smoothed: report.smoothed,
            limited: report.limited,
            rank: report.rank,
            functions: report.functions,
            guide_trust: report.guide_trust,
            median_share: report.median_share,
        }
    }
}

/// Returns the root mean square of the errors of used inliers; `None` if there are none.
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
