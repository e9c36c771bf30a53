//! Error against the number of points: one evaluation for each number.

use super::chart::{AxisScales, Chart, Line};
use super::html::write_charts;
use super::text::formatted;
use super::{Column, EvaluationReport, Heading};
use crate::metrics::{Metric, Scores};
use lsdc_files::error::{Error, Result};
use std::fmt::{Display, Formatter};
use std::path::Path;

/// Metrics of charts and tables.
const METRICS: [Metric; 2] = [Metric::Rmse, Metric::Rel];

/// Returns the heading without the points.
fn without_points(report: &EvaluationReport) -> Heading {
    let mut heading = report.heading().clone();
    heading.points.clear();
    if let Some(made_from) = heading.made_from.as_object_mut() {
        made_from.remove("points");
        made_from.remove("point_files");
    }
    heading
}

/// Mean scores of several methods at several numbers of points.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    dataset: String,
    methods: Vec<String>,
    /// Mean number of points, and each method's scores, sorted by increasing number of points.
    rows: Vec<(f64, Vec<Scores>)>,
}

impl Curve {
    /// Creates the curves from reports of the same methods on the same dataset and protocol.
    ///
    /// # Errors
    /// No reports, or reports with different settings.
    pub fn of(reports: &[EvaluationReport]) -> Result<Self> {
        let first = reports
            .first()
            .ok_or_else(|| Error::config("there is no report to draw"))?;
        for other in reports {
            if let Some(difference) = without_points(first).difference(&without_points(other)) {
                return Err(Error::config(format!(
                    "the reports do not belong to one curve: {difference}"
                ))
                .hint("everything but the points must be equal"));
            }
        }
        let row = |report: &EvaluationReport| {
            let frames = report.frames();
            let points: usize = frames.values().map(|f| f.points).sum();
            let means = report.means(None).into_iter();
            (
                points as f64 / frames.len().max(1) as f64,
                means.map(|m| m.mean).collect(),
            )
        };
        let mut rows: Vec<(f64, Vec<Scores>)> = reports.iter().map(row).collect();
        rows.sort_by(|a, b| a.0.total_cmp(&b.0));
        Ok(Self {
            dataset: first.heading().dataset.clone(),
            methods: first.heading().methods.clone(),
            rows,
        })
    }

    /// Writes a page with the curves and the table.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write_html(&self, path: &Path) -> Result<()> {
        let labels = METRICS.map(|metric| Column::of(metric).heading());
        let charts = METRICS.into_iter().zip(&labels).map(|(metric, label)| {
            let points = |method: usize| {
                let rows = self.rows.iter();
                rows.map(|(n, scores)| (*n, scores[method][metric]))
                    .collect()
            };
            let line = |colour: usize| Line {
                colour,
                points: points(colour),
                ..Line::default()
            };
            Chart {
                title: metric.label(),
                x_label: "sparse points",
                y_label: label,
                scales: AxisScales::LogX,
                lines: (0..self.methods.len()).map(line).collect(),
            }
        });
        let charts: Vec<Chart<'_>> = charts.collect();
        let title = format!("Error against points on {}", self.dataset);
        write_charts(path, &title, &self.methods, &charts, &self.to_string())
    }
}

impl Display for Curve {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        for metric in METRICS {
            write!(f, "{:<10}", metric.label())?;
            for method in &self.methods {
                write!(f, " {method:>10}")?;
            }
            writeln!(f)?;
            for (points, scores) in &self.rows {
                write!(f, "{points:<10.0}")?;
                for scores in scores {
                    write!(f, " {:>10}", formatted(metric, scores[metric]))?;
                }
                writeln!(f)?;
            }
        }
        Ok(())
    }
}
