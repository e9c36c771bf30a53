//! Tables of numbers, as text, CSV and HTML.

use super::drawing::escaped;
use super::html::markup;
use crate::metrics::{Metric, Scores};
use serde::Serialize;
use std::fmt::{Display, Formatter, Write as _};

/// A table of numbers with names and units.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Table {
    /// Title of the table.
    pub title: String,
    /// Heading of the column of names.
    #[serde(rename = "rows_are")]
    pub row_header: String,
    /// Which numbers are ranked against each other.
    #[serde(rename = "contest")]
    pub ranking: Ranking,
    /// Columns of numbers.
    pub columns: Vec<Column>,
    /// Rows of numbers.
    pub rows: Vec<Row>,
}

/// Which numbers of a table are ranked against each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Ranking {
    /// The rows, within every column.
    Rows,
    /// The columns, within every row.
    Columns,
    /// None.
    None,
}

/// A column of numbers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Column {
    /// Name of the column.
    pub label: String,
    /// Unit; empty for ratios.
    pub unit: &'static str,
    /// Number of decimals.
    pub decimals: usize,
    /// Whether higher values are better.
    #[serde(rename = "rising")]
    pub higher_is_better: bool,
}

/// A row of a table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Name of the row.
    pub label: String,
    /// Whether it is not ranked, because it is a published result or had more input.
    #[serde(rename = "aside")]
    pub unranked: bool,
    /// Values of the columns, in their units; `None` if missing.
    pub values: Vec<Option<f64>>,
}

impl Column {
    /// Returns the column of a metric.
    pub fn of(metric: Metric) -> Self {
        Self {
            label: metric.label().to_owned(),
            unit: metric.unit(),
            decimals: decimals(metric),
            higher_is_better: metric.is_share(),
        }
    }

    /// Returns the column of a metric under another name.
    pub fn named(label: &str, metric: Metric) -> Self {
        Self {
            label: label.to_owned(),
            ..Self::of(metric)
        }
    }

    /// Returns the name with the unit.
    pub(super) fn heading(&self) -> String {
        if self.unit.is_empty() {
            self.label.clone()
        } else {
            format!("{}, {}", self.label, self.unit)
        }
    }

    fn shown(&self, value: Option<f64>) -> String {
        match value {
            Some(value) if value.is_finite() => format!("{value:.*}", self.decimals),
            _ => "-".to_owned(),
        }
    }
}

fn decimals(metric: Metric) -> usize {
    match metric.unit() {
        "%" => 2,
        "1/km" => 1,
        _ => 4,
    }
}

impl Row {
    /// Returns the row of a method.
    pub fn of(label: &str, scores: &Scores, metrics: &[Metric]) -> Self {
        Self {
            label: label.to_owned(),
            unranked: false,
            values: metrics.iter().map(|&m| Some(value(scores, m))).collect(),
        }
    }
}

/// Returns a metric in the unit of tables.
pub(super) fn value(scores: &Scores, metric: Metric) -> f64 {
    if metric.is_share() {
        100.0 * scores[metric]
    } else {
        scores[metric]
    }
}

impl Table {
    /// Summarises where `ours` is not the best of the ranked numbers, or states that it is the best everywhere.
    pub fn ranking_summary(&self, ours: &str) -> Option<String> {
        let mut worse = Vec::new();
        let mut best_count = 0;
        for (row, column) in self.cells() {
            let name = self.competitor(row, column);
            let Some(value) = self.rows[row].values[column].filter(|_| name == ours) else {
                continue;
            };
            match self.best_other(row, column) {
                Some((rival, best)) if self.better(column, best, value) => {
                    let [best, value] = [best, value].map(|v| self.columns[column].shown(Some(v)));
                    // Values that are shown equal count as equal.
                    if best == value {
                        best_count += 1;
                    } else {
                        let at = self.metric_or_row_label(row, column);
                        worse.push(format!("{rival} in {at} ({best} against {value})"));
                    }
                }
                Some(_) => best_count += 1,
                None => (),
            }
        }
        match (worse.is_empty(), best_count) {
            (true, 0) => None,
            (true, _) => Some(format!(
                "{}: {ours} is the best of what was measured here everywhere.",
                self.title
            )),
            (false, _) => Some(format!(
                "{}: {ours} is behind {}; the best in the {best_count} others.",
                self.title,
                worse.join(", ")
            )),
        }
    }

    fn cells(&self) -> impl Iterator<Item = (usize, usize)> {
        let columns = self.columns.len();
        (0..self.rows.len()).flat_map(move |row| (0..columns).map(move |column| (row, column)))
    }

    /// Returns the name of the competitor that a number belongs to.
    fn competitor(&self, row: usize, column: usize) -> &str {
        match self.ranking {
            Ranking::Columns => &self.columns[column].label,
            _ => &self.rows[row].label,
        }
    }

    /// Returns the name of the quantity of a number.
    fn metric_or_row_label(&self, row: usize, column: usize) -> &str {
        match self.ranking {
            Ranking::Columns => &self.rows[row].label,
            _ => &self.columns[column].label,
        }
    }

    /// Returns the best of the numbers ranked against a number.
    fn best_other(&self, row: usize, column: usize) -> Option<(&str, f64)> {
        let rivals: Vec<(usize, usize)> = match self.ranking {
            Ranking::None => return None,
            Ranking::Rows => (0..self.rows.len()).map(|r| (r, column)).collect(),
            Ranking::Columns => (0..self.columns.len()).map(|c| (row, c)).collect(),
        };
        rivals
            .into_iter()
            .filter(|&cell| cell != (row, column) && !self.rows[cell.0].unranked)
            .filter_map(|(r, c)| Some((self.competitor(r, c), self.rows[r].values[c]?)))
            .filter(|(_, value)| value.is_finite())
            .reduce(|a, b| if self.better(column, b.1, a.1) { b } else { a })
    }

    fn better(&self, column: usize, a: f64, b: f64) -> bool {
        if self.columns[column].higher_is_better {
            a > b
        } else {
            a < b
        }
    }

    /// Returns whether a number is the best of the ranked ones.
    fn is_best(&self, row: usize, column: usize) -> bool {
        let Some(value) = self.rows[row].values[column].filter(|v| v.is_finite()) else {
            return false;
        };
        !self.rows[row].unranked
            && self
                .best_other(row, column)
                .is_some_and(|(_, best)| !self.better(column, best, value))
    }

    /// Returns the table as CSV, without its title.
    pub fn csv(&self) -> String {
        let quoted = |text: &str| format!("\"{}\"", text.replace('"', "\"\""));
        let headings = self.columns.iter().map(|c| quoted(&c.heading()));
        let mut lines = vec![
            [quoted(&self.row_header), quoted("aside")]
                .into_iter()
                .chain(headings)
                .collect::<Vec<_>>()
                .join(","),
        ];
        for row in &self.rows {
            let values = row
                .values
                .iter()
                .map(|v| v.map_or(String::new(), |v| v.to_string()));
            let line: Vec<String> = [quoted(&row.label), row.unranked.to_string()]
                .into_iter()
                .chain(values)
                .collect();
            lines.push(line.join(","));
        }
        lines.join("\n") + "\n"
    }

    /// Returns the table as HTML; the best numbers are highlighted, unranked ones are greyed out.
    pub fn html(&self) -> String {
        let mut html = format!(
            "<h3>{}</h3><div class='scroll'><table><thead><tr><th>{}</th>",
            escaped(&self.title),
            escaped(&self.row_header)
        );
        for column in &self.columns {
            let unit = column.unit;
            let label = markup(&column.label);
            let _ = write!(html, "<th>{label} <span class='spread'>{unit}</span></th>");
        }
        html.push_str("</tr></thead><tbody>");
        for (r, row) in self.rows.iter().enumerate() {
            let class = if row.unranked { " class='aside'" } else { "" };
            let _ = write!(html, "<tr{class}><td>{}</td>", escaped(&row.label));
            for (c, column) in self.columns.iter().enumerate() {
                let class = if self.is_best(r, c) {
                    " class='best'"
                } else {
                    ""
                };
                let _ = write!(html, "<td{class}>{}</td>", column.shown(row.values[c]));
            }
            html.push_str("</tr>");
        }
        html.push_str("</tbody></table></div>");
        html
    }
}

impl Display for Table {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        let first = self.rows.iter().map(|row| row.label.chars().count());
        let first = first
            .chain([self.row_header.chars().count()])
            .max()
            .unwrap_or(0);
        let widths: Vec<usize> = self
            .columns
            .iter()
            .map(|column| column.heading().chars().count().max(9))
            .collect();
        writeln!(f, "{}", self.title)?;
        write!(f, "  {:<first$}", self.row_header)?;
        for (column, width) in self.columns.iter().zip(&widths) {
            write!(f, "  {:>width$}", column.heading())?;
        }
        writeln!(f)?;
        for (r, row) in self.rows.iter().enumerate() {
            write!(f, "  {:<first$}", row.label)?;
            for (c, (column, width)) in self.columns.iter().zip(&widths).enumerate() {
                // A star marks the best.
                let mark = if self.is_best(r, c) { "*" } else { " " };
                let width = width - 1;
                write!(f, "  {:>width$}{mark}", column.shown(row.values[c]))?;
            }
            writeln!(f)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Table {
        let row = |label: &str, unranked, values: [f64; 2]| Row {
            label: label.to_owned(),
            unranked,
            values: values.map(Some).to_vec(),
        };
        Table {
            title: "T".to_owned(),
            row_header: "method".to_owned(),
            ranking: Ranking::Rows,
            columns: vec![Column::of(Metric::Rmse), Column::of(Metric::Delta1)],
            rows: vec![
                row("ours", false, [0.2, 97.0]),
                row("theirs", false, [0.3, 98.0]),
                row("paper", true, [0.1, 99.0]),
            ],
        }
    }

    #[test]
    fn what_others_published_does_not_compete() {
        let table = table();
        let leaders: Vec<_> = table
            .cells()
            .filter(|&(r, c)| table.is_best(r, c))
            .collect();
        assert_eq!(leaders, [(0, 0), (1, 1)]);
        assert_eq!(
            table.ranking_summary("ours").unwrap(),
            "T: ours is behind theirs in d1.25 (98.00 against 97.00); the best in the 1 others."
        );
        assert_eq!(table.ranking_summary("nobody"), None);
    }

    #[test]
    fn columns_compete_within_a_row() {
        let mut table = table();
        table.ranking = Ranking::Columns;
        table.columns = vec![
            Column::named("ours", Metric::Rmse),
            Column::named("linear", Metric::Rmse),
        ];
        table.rows.truncate(1);
        table.rows[0].values = vec![Some(0.1), Some(0.2)];
        let ranking_summary = table.ranking_summary("ours").unwrap();
        assert_eq!(
            ranking_summary,
            "T: ours is the best of what was measured here everywhere."
        );
    }
}
