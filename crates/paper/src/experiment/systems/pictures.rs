//! The pictures of the page.

use super::conditions::{COUNTS, Conditions};
use crate::experiment::tables::{line, show_by_count};
use lsdc_eval::metrics::Metric;
use lsdc_eval::report::{Section, Table};
use lsdc_files::error::Result;

/// Adds a chart of a metric against the number of points, from a table whose first row is the condition of the training.
pub(super) fn points(section: &mut Section, table: &Table, metric: Metric) {
    let columns = table.columns.iter().enumerate();
    let lines = columns.map(|(colour, column)| {
        let rows = COUNTS.iter().zip(&table.rows[1..]);
        let points = rows.filter_map(|(count, row)| Some((*count as f64, row.values[colour]?)));
        line(&column.label, colour, points.collect())
    });
    let name = format!("points-{}", metric.key());
    let caption = format!(
        "{} against the number of points; the systems are trained with one number.",
        metric.label()
    );
    show_by_count(section, &name, &caption, metric, lines.collect());
}

/// Adds frames with all predictions.
pub(super) fn frames(section: &mut Section, conditions: &Conditions<'_>) -> Result<()> {
    let caption = "The frame with lsdc's median RMSE, with the points of the training.";
    conditions.trained.show(section, "frame", caption)?;
    let few = "The same with 50 points.";
    conditions.few().show(section, "frame-50", few)?;
    let large = "Depth at three times the resolution of the image.";
    conditions.sharp.show(section, "frame-sharp", large)
}
