//! Tables of errors by range of true depth.

use super::{Column, EvaluationReport, Ranking, Row, Table};
use crate::metrics::{DepthRangeErrors, ErrorCount, Metric, RANGE_STARTS, total};

impl EvaluationReport {
    /// Describes the counts of the tables by depth; `None` if there are no tables.
    pub(super) fn about_ranges(&self) -> Option<String> {
        let certain = self.by_depth().first()?.columns.len() > ALL;
        let certain_text = match self.heading.sigma_cut {
            Some(cut) if certain => format!(
                "; kept: pixels whose predicted standard deviation is at most {cut} x the predicted depth"
            ),
            _ => String::new(),
        };
        Some(format!(
            "by true depth, over the pixels of all frames together; phantom: predicted nearer than truth / 1.25; \
             missed: predicted farther than 1.25 x truth{certain_text}"
        ))
    }

    /// Returns a table of all pixels and one for each range of true depth; none if all depths are in one range and no method
    /// has standard deviations.
    pub fn by_depth(&self) -> Vec<Table> {
        let ranges: Vec<&DepthRangeErrors> = self.sums.iter().map(|sums| &sums.ranges).collect();
        let pixels = |i: usize| ranges.first().map_or(0, |ranges| ranges.all[i].pixels);
        let used: Vec<usize> = (0..RANGE_STARTS.len()).filter(|i| pixels(*i) > 0).collect();
        let certain = ranges.iter().any(|ranges| ranges.certain.is_some());
        if used.is_empty() || (used.len() == 1 && !certain) {
            return Vec::new();
        }
        let sum: u64 = used.iter().map(|i| pixels(*i)).sum();
        let table =
            |title: String, of: &dyn Fn(&[ErrorCount; RANGE_STARTS.len()]) -> ErrorCount| Table {
                title,
                row_header: "method".to_owned(),
                ranking: Ranking::Rows,
                columns: columns(certain),
                rows: self
                    .heading
                    .methods
                    .iter()
                    .zip(&ranges)
                    .map(|(method, ranges)| Row {
                        label: method.clone(),
                        unranked: false,
                        values: values(of(&ranges.all), ranges.certain.as_ref().map(of), certain),
                    })
                    .collect(),
            };
        let mut tables = vec![table(format!("all depths, {sum} pixels"), &|counts| {
            total(counts)
        })];
        if used.len() > 1 {
            tables.extend(used.into_iter().map(|i| {
                let range = match RANGE_STARTS.get(i + 1) {
                    Some(end) => format!("{} to {end} m", RANGE_STARTS[i]),
                    None => format!("{} m and more", RANGE_STARTS[i]),
                };
                let share = 100.0 * pixels(i) as f64 / sum as f64;
                let title = format!("{range}, {} pixels ({share:.1} %)", pixels(i));
                table(title, &|counts| counts[i])
            }));
        }
        tables
    }
}

/// Number of columns that every method has.
const ALL: usize = 5;

fn columns(certain: bool) -> Vec<Column> {
    let share = |label: &str, higher_is_better: bool| Column {
        label: label.to_owned(),
        unit: "%",
        decimals: 2,
        higher_is_better,
    };
    let mut columns: Vec<Column> = [Metric::Rmse, Metric::Mae, Metric::Rel]
        .map(Column::of)
        .into();
    columns.extend(["phantom", "missed"].map(|label| share(label, false)));
    if certain {
        columns.push(share("kept", true));
        columns.extend(["phantom of kept", "missed of kept"].map(|label| share(label, false)));
    }
    columns
}

/// Returns the values of a row; values without pixels, which are NaN, are left out.
fn values(all: ErrorCount, certain_counts: Option<ErrorCount>, certain: bool) -> Vec<Option<f64>> {
    let rates =
        |count: ErrorCount| [count.phantom_rate(), count.missed_rate()].map(|rate| 100.0 * rate);
    let mut values = vec![all.rmse(), all.mae(), all.rel()];
    values.extend(rates(all));
    let mut values: Vec<Option<f64>> = values.into_iter().map(Some).collect();
    if certain {
        let share = |count: ErrorCount| 100.0 * count.pixels as f64 / all.pixels as f64;
        values.push(certain_counts.map(share));
        let certain_rates = certain_counts.map(rates);
        values.extend([0, 1].map(|i| certain_rates.map(|rates| rates[i])));
    }
    let finite = |value: Option<f64>| value.filter(|value| value.is_finite());
    values.into_iter().map(finite).collect()
}
