//! Rows, columns and charts shared by several experiments.

use lsdc_eval::metrics::Metric;
use lsdc_eval::report::{AxisScales, Chart, Column, Line, Ranking, Row, Section, Table};

/// Returns a row of measured values.
pub(super) fn row(label: impl Into<String>, values: impl Into<Vec<Option<f64>>>) -> Row {
    Row {
        label: label.into(),
        unranked: false,
        values: values.into(),
    }
}

/// Returns a column in which the smallest value is the best.
pub(super) fn column(label: impl Into<String>, unit: &'static str, decimals: usize) -> Column {
    Column {
        label: label.into(),
        unit,
        decimals,
        higher_is_better: false,
    }
}

/// Returns a table of scores with a row for each method.
pub(super) fn of_methods(title: impl Into<String>, metrics: &[Metric], rows: Vec<Row>) -> Table {
    Table {
        title: title.into(),
        row_header: "method".into(),
        ranking: Ranking::Rows,
        columns: metrics.iter().map(|&metric| Column::of(metric)).collect(),
        rows,
    }
}

/// Returns a measured curve with a name.
pub(super) fn line(name: &str, colour: usize, points: Vec<(f64, f64)>) -> Line {
    Line {
        name: Some(name.to_owned()),
        colour,
        dashed: false,
        points,
    }
}

/// Adds a chart of a metric against the number of points.
pub(super) fn show_by_count(
    section: &mut Section,
    name: &str,
    caption: &str,
    metric: Metric,
    lines: Vec<Line>,
) {
    let chart = Chart {
        title: metric.label(),
        x_label: "sparse points",
        y_label: &axis(metric),
        scales: AxisScales::LogLog,
        lines,
    };
    section.add_figure(name, caption, chart.draw());
}

/// Returns the label of an axis, with its unit.
pub(super) fn axis(metric: Metric) -> String {
    match metric.unit() {
        "" => metric.label().to_owned(),
        unit => format!("{}, {unit}", metric.label()),
    }
}
