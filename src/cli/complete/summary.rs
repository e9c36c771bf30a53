//! A completed frame in numbers, as reports have it; `lines` puts it into words.

use super::export::{ExportCounts, Exported};
use super::frame::{Completed, LeftEmpty};
use super::loaded::{Loaded, Noise};
use super::outputs::FormatData;
use super::views::DescribedViews;
use crate::cli::ui::counted;
use lsdc_core::Quality;
use lsdc_eval::data::Unit;
use lsdc_files::{DescribedCloud, DescribedDepth, DescribedFit, DescribedPng, DescribedPoints};
use serde::Serialize;
use serde_json::Value;
use std::path::Path;
use std::time::Duration;

/// A frame in numbers: metres, seconds.
#[derive(Debug, Serialize)]
pub(super) struct Summary {
    image: String,
    status: &'static str,
    pub(super) points: PointCounts,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) noise: Option<DescribedNoise>,
    pub(super) depth: Option<DescribedDepth>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) left_empty: Option<LeftEmpty>,
    /// Depths of the first and the last colour of the colour map.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) color_range: Option<(f32, f32)>,
    #[serde(flatten)]
    png: Option<DescribedPng>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) cloud: Option<DescribedCloud>,
    /// In workspaces for other programs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) exported: Option<ExportCounts>,
    /// If it is not the standard one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) quality: Option<Quality>,
    /// If it was given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) encoder_side: Option<usize>,
    /// The network that predicted the guide, the shorter side of its image, its head if it is the published one, and the
    /// hash of its tensors.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) guide: Option<String>,
    pub(super) fit: Option<DescribedFit>,
    /// With `--views`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) views: Option<DescribedViews>,
    /// The unit of depths.
    #[serde(skip)]
    metres: &'static str,
    /// Whether the fit limits the influence of outliers.
    #[serde(skip)]
    pub(super) robust: bool,
    pub(super) seconds: Seconds,
    /// Warnings: assumptions to check, and what was left out.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    remarks: Vec<String>,
}

/// The noise of a depth camera.
#[derive(Debug, Serialize)]
pub(super) struct DescribedNoise {
    /// The name, if it has one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) name: Option<&'static str>,
    /// A, B and C of the standard deviation A + B z + C z^2 in metres.
    coefficients: [f64; 3],
    /// Number of points whose standard deviation comes from it.
    pub(super) points: usize,
    #[serde(skip)]
    pub(super) formula: String,
}

impl From<Noise> for DescribedNoise {
    fn from(Noise { model, points }: Noise) -> Self {
        Self {
            name: model.name(),
            coefficients: model.coefficients(),
            points,
            formula: model.to_string(),
        }
    }
}

#[derive(Debug, Serialize)]
pub(super) struct PointCounts {
    #[serde(flatten)]
    pub(super) counts: DescribedPoints,
    /// Measured when the place of the scanner is not known.
    #[serde(skip_serializing_if = "is_zero")]
    unplaced: usize,
    /// Whether all count at the stamp of their cloud, though those of other frames do not.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    skewed: bool,
    /// Whether the method looks at the deviations that came with the points; without that they only
    /// weigh points of one pixel, of which it sees the mean.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) deviations_used: Option<bool>,
}

#[allow(clippy::trivially_copy_pass_by_ref)]
fn is_zero(count: &usize) -> bool {
    *count == 0
}

#[derive(Debug, Serialize)]
pub(super) struct Seconds {
    pub(super) reading: f64,
    /// The prediction of the guide.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) guide: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) network: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) fit: Option<f64>,
    /// Part of the fit: the field of the image before any point.
    #[serde(skip_serializing_if = "Option::is_none")]
    field: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) dense: Option<f64>,
}

impl Summary {
    /// The numbers of a frame, its result, and what the formats add.
    pub(super) fn new(
        name: &Path,
        frame: &Loaded,
        found: &Completed,
        format_data: &FormatData,
    ) -> Self {
        let Loaded { points, .. } = frame;
        let fit = found.diagnostics.as_ref();
        let report = fit.map(|fit| fit.completion.report());
        let seconds = |stage: Duration| stage.as_secs_f64();
        let mut remarks = points.remarks.clone();
        let without = report.map_or(0, |report| report.without_deviation);
        if without > 0 {
            let count = counted(without, "point");
            remarks.push(format!(
                "{count} without a standard deviation: the fit's own noise is assumed for them"
            ));
        }
        let mut summary = Self {
            image: name.display().to_string(),
            status: "completed",
            points: PointCounts {
                counts: DescribedPoints::new(points, fit.map(|fit| &fit.completion)),
                unplaced: frame.unplaced,
                skewed: frame.skewed,
                deviations_used: points
                    .points
                    .iter()
                    .any(|point| point.sigma.is_some())
                    .then_some(fit.is_some()),
            },
            noise: frame.noise.map(DescribedNoise::from),
            depth: DescribedDepth::new(&found.depth, found.clamped),
            left_empty: found.left_empty,
            color_range: format_data.color_range,
            png: format_data.png,
            cloud: format_data.cloud.as_ref().map(DescribedCloud::from),
            exported: format_data.exported.as_ref().map(Exported::counts),
            quality: (found.quality != Quality::Standard).then_some(found.quality),
            encoder_side: found.encoder_side,
            guide: found.guide.clone(),
            fit: fit.map(|fit| {
                DescribedFit::new(
                    &fit.completion,
                    fit.leave_one_out,
                    fit.outliers.as_deref(),
                    fit.deviations.is_some(),
                )
            }),
            views: None,
            metres: points.unit.of_depths(),
            robust: fit.is_some_and(|fit| fit.robust),
            seconds: Seconds {
                reading: seconds(frame.reading),
                guide: found.guide_time.map(seconds),
                network: report.map(|report| seconds(report.network)),
                fit: report.map(|report| seconds(report.fit)),
                field: report.map(|report| seconds(report.field)),
                dense: fit.map(|fit| seconds(fit.dense)),
            },
            remarks,
        };
        if let (Some(views), Some(report)) = (&frame.views, &found.views) {
            summary.add_views(views.described(report));
        }
        summary
    }

    /// Adds what became of the points of other images.
    fn add_views(&mut self, views: DescribedViews) {
        // The fit counts all points.
        self.points.counts.used = self.points.counts.used.saturating_sub(views.carried);
        self.remarks.extend(views.remark());
        self.views = Some(views);
    }

    /// Warnings: assumptions to check, and what was left out.
    pub(super) fn remarks(&self) -> &[String] {
        &self.remarks
    }

    pub(super) fn value(&self) -> Value {
        // Numbers and names always have a form.
        serde_json::to_value(self).unwrap_or_default()
    }

    /// The unit of the 16-bit PNG, if it is not the usual one.
    pub(super) fn unusual_png_unit(&self) -> Option<Unit> {
        let unit = self.png.map(|png| png.unit);
        unit.filter(|unit| *unit != Unit::MILLIMETRE)
    }

    /// Pixels that hold one unit of the PNG, as they are nearer than half of it.
    pub(super) fn png_raised(&self) -> usize {
        self.png.map_or(0, |png| png.raised)
    }

    /// Pixels without a depth, as their standard deviation is too large.
    pub(super) fn left_empty(&self) -> usize {
        self.left_empty.map_or(0, |left| left.pixels)
    }

    /// Pixels that have no point in the cloud: uncertain ones, unless they are empty in the map too, those where the lens does
    /// not look, flying ones, and those that share a voxel with others.
    pub(super) fn left_out_of_cloud(&self) -> [usize; 4] {
        let told = self.left_empty.is_some();
        self.cloud.as_ref().map_or([0; 4], |cloud| {
            let uncertain = if told { 0 } else { cloud.uncertain };
            [uncertain, cloud.unseen, cloud.flying, cloud.merged]
        })
    }

    /// The unit of depths.
    pub(super) fn metres(&self) -> &'static str {
        self.metres
    }

    /// Points that were not fitted: without a usable depth, outside the image, behind others, and without a known place.
    pub(super) fn left_out_of_points(&self) -> [usize; 4] {
        let PointCounts {
            counts, unplaced, ..
        } = &self.points;
        [counts.ignored, counts.outside, counts.hidden, *unplaced]
    }

    /// Whether all points count at the stamp of their cloud, though those of other frames do not.
    pub(super) fn is_skewed(&self) -> bool {
        self.points.skewed
    }

    /// Whether a text is the same but for times.
    pub(super) fn is_but_for_times(&self, text: &str) -> bool {
        let parsed = |text: &str| {
            let mut value: Value = serde_json::from_str(text).ok()?;
            value.as_object_mut()?.remove("seconds");
            Some(value)
        };
        parsed(text).is_some_and(|old| Some(old) == parsed(&self.value().to_string()))
    }
}
