//! Numbers of a completion, with the names of `lsdc complete --json`, as far as available: metres, and counts.

use lsdc_core::{Completion, DepthMap, Outlier};
use serde::Serialize;

/// A completion without its maps.
#[derive(Debug, Serialize)]
pub(crate) struct Report {
    points: Points,
    depth: Option<Depth>,
    fit: Fit,
    /// Worst first; null if the points were not tested.
    outliers: Option<Vec<OutlierEntry>>,
    /// Warnings: assumptions to check, and what was left out.
    pub(crate) remarks: Vec<String>,
}

#[derive(Debug, Serialize)]
struct Points {
    given: usize,
    used: usize,
    /// Number of points with an unusable depth or position.
    ignored: usize,
    outside: usize,
    without_deviation: usize,
}

#[derive(Debug, Serialize)]
struct Depth {
    lowest: f32,
    highest: f32,
    /// Number of pixels limited because they are far outside the range of the points.
    clamped: usize,
}

#[derive(Debug, Serialize)]
struct Fit {
    method: &'static str,
    residual: f64,
    leave_one_out: Option<f64>,
    outliers: Option<usize>,
    deviations_of_95: Option<f64>,
    smoothed: usize,
    limited: usize,
    rank: usize,
    functions: usize,
    median_share: Option<f64>,
}

#[derive(Debug, Serialize)]
struct OutlierEntry {
    index: usize,
    probability: f64,
    score: f64,
    error: f64,
    weight: f64,
}

impl From<&Outlier> for OutlierEntry {
    fn from(outlier: &Outlier) -> Self {
        Self {
            index: outlier.index,
            probability: outlier.probability,
            score: outlier.score,
            error: outlier.error,
            weight: outlier.weight,
        }
    }
}

impl Report {
    /// Creates the report of a completion and its depth. `outliers`: present if the points were tested; `deviations`: whether
    /// there are standard deviations.
    pub(crate) fn new(
        completion: &Completion,
        depth: &DepthMap,
        outliers: Option<&[Outlier]>,
        deviations: bool,
    ) -> Self {
        let report = completion.report();
        let clamped = completion.clamped_pixels(depth);
        let interval = deviations.then(|| completion.interval(0.95).ok());
        let leave_one_out = outliers.map(|_| completion.leave_one_out_error());
        Self {
            points: Points {
                given: report.given,
                used: report.used,
                ignored: report.invalid,
                outside: report.outside,
                without_deviation: report.without_deviation,
            },
            depth: depth.range().map(|(lowest, highest)| Depth {
                lowest,
                highest,
                clamped,
            }),
            fit: Fit {
                method: report.method.name(),
                residual: report.residual,
                leave_one_out: leave_one_out.flatten(),
                outliers: outliers.map(<[Outlier]>::len),
                deviations_of_95: interval.flatten(),
                smoothed: report.smoothed,
                limited: report.limited,
                rank: report.rank,
                functions: report.functions,
                median_share: report.median_share,
            },
            outliers: outliers.map(|all| all.iter().map(OutlierEntry::from).collect()),
            remarks: Vec::new(),
        }
    }

    pub(crate) fn json(&self) -> String {
        // Numbers and names can always be serialised.
        serde_json::to_string(self).unwrap_or_default()
    }
}
