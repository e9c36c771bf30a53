//! Comparison of errors with other methods (Fang et al., table 1).

use super::trial::{Measured, Trial};
use super::{ExperimentContext, Study, published, tables};
use lsdc_eval::evaluation::Candidate;
use lsdc_eval::metrics::Metric;
use lsdc_eval::predict::{Classic, Method};
use lsdc_eval::report::{Row, Section};
use lsdc_files::error::Result;

/// Baselines evaluated in all comparisons of methods.
pub(super) const BASELINES: [Method; 3] = [
    Method::Classic(Classic::Linear),
    Method::Classic(Classic::Smooth),
    Method::Classic(Classic::Steering),
];

/// Returns `lsdc` and the baselines.
pub(super) fn all() -> Vec<Method> {
    [Method::Lsdc].into_iter().chain(BASELINES).collect()
}

const METRICS: [Metric; 7] = [
    Metric::Rmse,
    Metric::Rel,
    Metric::Delta1,
    Metric::Delta2,
    Metric::Delta3,
    Metric::Mae,
    Metric::See,
];

pub(super) struct Benchmark<'a> {
    context: &'a ExperimentContext,
    methods: Measured<'a>,
    plain: Measured<'a>,
}

impl<'a> Benchmark<'a> {
    pub(super) fn new(context: &'a ExperimentContext) -> Self {
        let others = context.predictions.iter();
        let others = others.map(|(name, folder)| (name.clone(), Candidate::Files(folder.clone())));
        Self {
            context,
            methods: Measured::new(context, "benchmark")
                .methods(&all())
                .with_candidates(others),
            plain: Measured::new(context, "benchmark-plain").paper_fit(),
        }
    }
}

impl Study for Benchmark<'_> {
    fn trials(&self) -> Vec<&dyn Trial> {
        vec![&self.methods, &self.plain]
    }

    fn section(&self) -> Result<Section> {
        let mut section = Section::new("benchmark", "Errors beside other methods (table 1)");
        section.about.push(format!(
            "{} {}.",
            self.context.about(),
            self.context.preset.points
        ));
        let measured = self.methods.means()?;
        let mut rows: Vec<Row> = measured
            .iter()
            .map(|(name, scores)| Row::of(name, scores, &METRICS))
            .collect();
        let plain = self.plain.first_scores()?;
        rows.insert(1, Row::of("lsdc, the paper's fit", &plain, &METRICS));
        for (name, errors) in published::TABLE_1 {
            let mut values = errors.to_vec();
            values.resize(METRICS.len(), None);
            rows.push(published::row(name, values));
        }
        let title = format!("Errors, {}", self.context.preset.points);
        let table = tables::of_methods(title, &METRICS, rows);
        section.add_ranked_table(table, "lsdc");
        section.about.push(
            "\"The paper's fit\" has the same basis functions without field, cosines and prior: \
             least squares by truncated SVD."
                .into(),
        );
        section.notes = published::notes(&published::TABLE_1_NOTES);
        let caption = "The frame with lsdc's median RMSE.";
        self.methods.show(&mut section, caption)?;
        Ok(section)
    }
}
