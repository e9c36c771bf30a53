//! Error against the number of points: one evaluation for each number.

use super::chart::{Chart, Line, Scales};
use super::drawing::escaped;
use super::html::{begin, legend};
use super::text::shown;
use super::{Heading, Report};
use crate::data::write_atomically;
use crate::metrics::{Metric, Scores};
use lsdc_files::error::{Error, Result};
use std::fmt::{Display, Formatter, Write as _};
use std::path::Path;

/// A heading that says nothing of the points.
fn but_for_points(report: &Report) -> Heading {
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
    /// The mean number of points, and each method's scores; the fewest points first.
    rows: Vec<(f64, Vec<Scores>)>,
}

impl Curve {
    /// Reports of the same methods on the same dataset and protocol.
    ///
    /// # Errors
    /// None, or reports that measure something else.
    pub fn of(reports: &[Report]) -> Result<Self> {
        let first = reports
            .first()
            .ok_or_else(|| Error::config("there is no report to draw"))?;
        for other in reports {
            if let Some(difference) = but_for_points(first).difference(&but_for_points(other)) {
                return Err(Error::config(format!(
                    "the reports do not belong to one curve: {difference}"
                ))
                .hint("everything but the points must be equal"));
            }
        }
        let row = |report: &Report| {
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
        let mut page = begin(&format!("Error against points on {}", self.dataset));
        page.push_str(&legend(&self.methods));
        page.push_str("<div class='charts'>");
        for metric in [Metric::Rmse, Metric::Rel] {
            let lines = (0..self.methods.len()).map(|colour| Line {
                colour,
                points: self
                    .rows
                    .iter()
                    .map(|(n, s)| (*n, s[colour][metric]))
                    .collect(),
                ..Line::default()
            });
            let up = match metric.unit() {
                "" => metric.label().to_owned(),
                unit => format!("{}, {unit}", metric.label()),
            };
            let chart = Chart {
                title: metric.label(),
                across: "sparse points",
                up: &up,
                scales: Scales::LogarithmicAcross,
                lines: lines.collect(),
            };
            page.push_str(&chart.svg());
        }
        let table = escaped(&self.to_string());
        let _ = writeln!(page, "</div><pre>{table}</pre></body></html>");
        write_atomically(path, |out| out.write_all(page.as_bytes()))
    }
}

impl Display for Curve {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        for metric in [Metric::Rmse, Metric::Rel] {
            write!(f, "{:<10}", metric.label())?;
            for method in &self.methods {
                write!(f, " {method:>10}")?;
            }
            writeln!(f)?;
            for (points, scores) in &self.rows {
                write!(f, "{points:<10.0}")?;
                for scores in scores {
                    write!(f, " {:>10}", shown(metric, scores[metric]))?;
                }
                writeln!(f)?;
            }
        }
        Ok(())
    }
}
