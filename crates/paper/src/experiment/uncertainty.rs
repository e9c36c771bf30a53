//! Calibration of predicted standard deviations, for few and many points in different patterns.

use super::tables::{self, column};
use super::trial::{Measured, Trial};
use super::{ExperimentContext, Study};
use lsdc_eval::metrics::{Metric, UncertaintyScores};
use lsdc_eval::report::{Column, Ranking, Row, Section, Table};
use lsdc_eval::sampling::Pattern;
use lsdc_files::error::{Error, Result};

/// Patterns of about 5, 50, 500 and 5,000 points at 304x228. Each row of a laser scanner has many points.
const PATTERNS: [Pattern; 18] = [
    Pattern::Exactly(5),
    Pattern::Grid(118),
    Pattern::Corners(5),
    Pattern::Half(5),
    Pattern::Exactly(50),
    Pattern::Grid(37),
    Pattern::Corners(50),
    Pattern::Half(50),
    Pattern::Exactly(500),
    Pattern::Grid(12),
    Pattern::Lines(2),
    Pattern::Corners(500),
    Pattern::Half(500),
    Pattern::Exactly(5000),
    Pattern::Grid(4),
    Pattern::Lines(16),
    Pattern::Corners(5000),
    Pattern::Half(5000),
];

pub(super) struct Uncertainty<'a> {
    context: &'a ExperimentContext,
    trials: Vec<(String, Measured<'a>)>,
}

impl<'a> Uncertainty<'a> {
    pub(super) fn new(context: &'a ExperimentContext) -> Self {
        let trial = |pattern: Pattern| {
            let name = String::from(pattern.clone());
            let trial = Measured::new(context, format!("uncertainty-{}", name.replace(':', "-")))
                .points(pattern)
                .uncertainty();
            (name, trial)
        };
        Self {
            context,
            trials: PATTERNS.map(trial).into(),
        }
    }
}

impl Study for Uncertainty<'_> {
    fn trials(&self) -> Vec<&dyn Trial> {
        let trials = self.trials.iter();
        trials.map(|(_, trial)| trial as &dyn Trial).collect()
    }

    fn section(&self) -> Result<Section> {
        let mut section = Section::new("uncertainty", "Whether standard deviations hold");
        section.about.push(self.context.about());
        let mut rows = Vec::new();
        for (pattern, trial) in &self.trials {
            let report = trial.report()?;
            let uncertainty = report.uncertainty(0);
            let uncertainty = uncertainty.ok_or_else(|| {
                Error::config(format!("`{}` has no standard deviations", trial.name()))
                    .hint("use weights with a prior")
            })?;
            rows.push(row(
                pattern,
                trial.first_scores()?[Metric::Rmse],
                uncertainty,
            ));
        }
        let share = |label: &str| Column {
            higher_is_better: true,
            ..column(label, "%", 1)
        };
        section.tables.push(Table {
            title: "Errors and the intervals that were predicted for them".into(),
            row_header: "points".into(),
            ranking: Ranking::None,
            columns: vec![
                Column::named("RMSE", Metric::Rmse),
                share("within 68.3 % intervals"),
                share("within 95.4 % intervals"),
                column("negative log-likelihood", "", 3),
                column("AUSE / random order", "", 3),
            ],
            rows,
        });
        section.notes.push(
            "A `grid:STEP` of 118, 37, 12 and 4 pixels has about 5, 50, 500 and 4,300 points, `lines:N` of 2 and 16 \
             rows about 600 and 4,900."
                .into(),
        );
        Ok(section)
    }
}

fn row(pattern: &str, rmse: f64, uncertainty: &UncertaintyScores) -> Row {
    let (one, two) = uncertainty.coverage();
    let values = [
        rmse,
        100.0 * one,
        100.0 * two,
        uncertainty.neg_log_likelihood(),
        uncertainty.ause_of_random(),
    ];
    tables::row(pattern, values.map(Some))
}
