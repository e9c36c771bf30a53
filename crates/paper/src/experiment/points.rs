//! Errors against the number of points.

use super::benchmark;
use super::tables::{line, row, show_by_count};
use super::trial::{Measured, Trial, as_trials};
use super::{ExperimentContext, Study};
use lsdc_eval::metrics::Metric;
use lsdc_eval::report::{Column, Line, Ranking, Section, Table};
use lsdc_eval::sampling::Pattern;
use lsdc_files::error::Result;

const COUNTS: [usize; 9] = [50, 100, 200, 500, 1000, 2000, 5000, 10_000, 20_000];

pub(super) struct PointsStudy<'a> {
    context: &'a ExperimentContext,
    trials: Vec<Measured<'a>>,
}

impl<'a> PointsStudy<'a> {
    pub(super) fn new(context: &'a ExperimentContext) -> Self {
        let trial = |count: usize| {
            Measured::new(context, format!("points-{count}"))
                .methods(&benchmark::all())
                .points(Pattern::Exactly(count))
        };
        Self {
            context,
            trials: COUNTS.map(trial).into(),
        }
    }
}

impl Study for PointsStudy<'_> {
    fn trials(&self) -> Vec<&dyn Trial> {
        as_trials(&self.trials)
    }

    fn section(&self) -> Result<Section> {
        let mut section = Section::new("points", "Errors against the number of points");
        section.about.push(self.context.about());
        for metric in [Metric::Rmse, Metric::Rel] {
            let labels = COUNTS.map(|count| (count.to_string(), count as f64));
            let (table, lines) = compare(metric, &labels, "points", &self.trials)?;
            section.add_ranked_table(table, "lsdc");
            let caption = format!("{} against the number of points.", metric.label());
            show_by_count(&mut section, metric.key(), &caption, metric, lines);
        }
        section.notes.push(
            "Of the paper, 0.148 m at 500 and 0.129 m at 1000 points are known; below N its fit cannot \
             be solved."
                .into(),
        );
        Ok(section)
    }
}

/// Compares a metric of several methods under several conditions, as a table with a column for each method, and as lines.
pub(super) fn compare(
    metric: Metric,
    conditions: &[(String, f64)],
    row_header: &str,
    trials: &[Measured<'_>],
) -> Result<(Table, Vec<Line>)> {
    let mut names = Vec::new();
    let mut rows = Vec::new();
    let mut curves: Vec<Vec<(f64, f64)>> = Vec::new();
    for ((label, at), trial) in conditions.iter().zip(trials) {
        let means = trial.means()?;
        names = means.iter().map(|(name, _)| name.clone()).collect();
        curves.resize(means.len(), Vec::new());
        for (curve, (_, scores)) in curves.iter_mut().zip(&means) {
            curve.push((*at, scores[metric]));
        }
        let values: Vec<_> = means.iter().map(|(_, s)| Some(s[metric])).collect();
        rows.push(row(label, values));
    }
    let lines = names.iter().zip(curves).enumerate();
    let lines = lines.map(|(colour, (name, points))| line(name, colour, points));
    let table = Table {
        title: metric.label().to_owned(),
        row_header: row_header.to_owned(),
        ranking: Ranking::Columns,
        columns: names.iter().map(|n| Column::named(n, metric)).collect(),
        rows,
    };
    Ok((table, lines.collect()))
}
