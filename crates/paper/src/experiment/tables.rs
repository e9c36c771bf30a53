//! Rows, columns and charts that several experiments have.

use lsdc_eval::metrics::Metric;
use lsdc_eval::report::{AxisScales, Chart, Column, Line, Ranking, Row, Section, Table};

/// A row of what was measured here.
pub(super) fn row(label: impl Into<String>, values: impl Into<Vec<Option<f64>>>) -> Row {
    Row {
        label: label.into(),
        unranked: false,
        values: values.into(),
    }
}

/// A column of numbers of which the smallest is the best.
pub(super) fn column(label: impl Into<String>, unit: &'static str, decimals: usize) -> Column {
    Column {
        label: label.into(),
        unit,
        decimals,
        higher_is_better: false,
    }
}

/// The scores of methods, a row for each.
pub(super) fn of_methods(title: impl Into<String>, metrics: &[Metric], rows: Vec<Row>) -> Table {
    Table {
        title: title.into(),
        row_header: "method".into(),
        ranking: Ranking::Rows,
        columns: metrics.iter().map(|&metric| Column::of(metric)).collect(),
        rows,
    }
}

/// A measured curve with a name.
pub(super) fn line(name: &str, colour: usize, points: Vec<(f64, f64)>) -> Line {
    Line {
        name: Some(name.to_owned()),
        colour,
        dashed: false,
        points,
    }
}

/// Adds a chart of a measure against the number of points.
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

/// The name of an axis, with its unit.
pub(super) fn axis(metric: Metric) -> String {
    match metric.unit() {
        "" => metric.label().to_owned(),
        unit => format!("{}, {unit}", metric.label()),
    }
}
