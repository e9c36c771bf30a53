//! Errors with noisy points, with and without robust losses (Fang et al., section 4.4).

use super::benchmark::{BASELINES, all};
use super::trial::{Measured, Trial};
use super::{ExperimentContext, Study, published, tables};
use lsdc_core::fit::{Loss, Robust};
use lsdc_eval::metrics::{Metric, Scores};
use lsdc_eval::report::{Column, Panels, Ranking, Row, Section, Table};
use lsdc_eval::sampling::{Noise, Pattern};
use lsdc_files::error::Result;

const POINTS: usize = 1000;
const NOISE: Noise = Noise::Added {
    share: 0.3,
    most: 1.0,
};
/// The loss used for `lsdc` in comparisons with methods that have none.
const OURS: Loss = Loss::Auto;
/// Other kinds of noise: label of the column, name in files, noise.
const OTHERS: [(&str, &str, Noise); 4] = [
    ("gross outliers", "outliers", Noise::Outliers { share: 0.3 }),
    (
        "moved",
        "moved",
        Noise::Moved {
            least: 2.0,
            most: 4.0,
        },
    ),
    (
        "a region",
        "region",
        Noise::Region {
            share: 0.1,
            metres: 0.5,
        },
    ),
    ("as of stereo", "stereo", Noise::Stereo { factor: 0.01 }),
];
/// Numbers of points without noise.
const CLEAN: [usize; 6] = [5, 50, 200, 500, 1000, 5000];
/// Losses compared.
const COMPARED: [Option<Loss>; 4] = [
    None,
    Some(Loss::Huber),
    Some(Loss::Cauchy),
    Some(Loss::Auto),
];

pub(super) struct NoiseStudy<'a> {
    context: &'a ExperimentContext,
    clean: Measured<'a>,
    noisy: Measured<'a>,
    robust: Vec<(Loss, Measured<'a>)>,
    /// Measurements with the other kinds of noise, for each of the compared losses.
    others: Vec<Vec<Measured<'a>>>,
    /// Measurements without noise, for each of the compared losses.
    untouched: Vec<Vec<Measured<'a>>>,
}

impl<'a> NoiseStudy<'a> {
    pub(super) fn new(context: &'a ExperimentContext) -> Self {
        let trial = |name: &str| Measured::new(context, name).points(Pattern::Exactly(POINTS));
        let robust = |loss: Loss| {
            let trial = trial(&format!("noise-{}", loss.name()))
                .noise(Some(NOISE))
                .fit(|fit| fit.robust = Some(Robust::new(loss)));
            (loss, trial)
        };
        let named = |kind: &str, loss: Option<Loss>, points: usize| {
            let name = format!("noise-{kind}-{}", loss.map_or("none", Loss::name));
            Measured::new(context, name)
                .points(Pattern::Exactly(points))
                .fit(|fit| fit.robust = loss.map(Robust::new))
        };
        let others = |loss: Option<Loss>| {
            let kinds = OTHERS.iter();
            let trials =
                kinds.map(|(_, kind, noise)| named(kind, loss, POINTS).noise(Some(*noise)));
            trials.collect()
        };
        let untouched = |loss: Option<Loss>| {
            let counts = CLEAN.iter();
            let trials = counts.map(|&count| named(&format!("clean-{count}"), loss, count));
            trials.collect()
        };
        Self {
            context,
            others: COMPARED.map(others).into(),
            untouched: COMPARED.map(untouched).into(),
            clean: trial("noise-clean").methods(&all()),
            noisy: trial("noise-none").methods(&all()).noise(Some(NOISE)),
            robust: Loss::ALL.map(robust).into(),
        }
    }
}

impl Study for NoiseStudy<'_> {
    fn trials(&self) -> Vec<&dyn Trial> {
        let mut trials: Vec<&dyn Trial> = vec![&self.clean, &self.noisy];
        trials.extend(self.robust.iter().map(|(_, trial)| trial as &dyn Trial));
        let more = self.others.iter().chain(&self.untouched).flatten();
        trials.extend(more.map(|trial| trial as &dyn Trial));
        trials
    }

    fn section(&self) -> Result<Section> {
        let mut section = Section::new("noise", "Wrong points, with and without robust losses");
        section.about.push(format!(
            "{} {POINTS} points, {}.",
            self.context.about(),
            NOISE
        ));
        let clean = self.clean.means()?;
        let noisy = self.noisy.means()?;
        let row = |label: &str, clean: &Scores, noisy: &Scores| {
            let (before, after) = (clean[Metric::Rmse], noisy[Metric::Rmse]);
            let more = 100.0 * (after / before - 1.0);
            tables::row(label, [before, after, more, noisy[Metric::Rel]].map(Some))
        };
        let mut rows = Vec::new();
        for ((name, clean), (_, noisy)) in clean.iter().zip(&noisy) {
            rows.push(row(name, clean, noisy));
        }
        let mut ours = Vec::new();
        for (loss, trial) in &self.robust {
            ours.push(row(
                &robust_name(*loss),
                &clean[0].1,
                &trial.first_scores()?,
            ));
        }
        let mut baselines = vec![ours.iter().find(|r| r.label == robust_name(OURS)).cloned()];
        baselines.extend(rows.iter().skip(1).cloned().map(Some));
        rows.splice(1..1, ours);
        let [before, after, irls] = published::NOISE;
        let more = |value: f64| Some(100.0 * (value / before - 1.0));
        for (name, value) in [
            ("LSE (section 4.4)", after),
            ("LSE, IRLS (section 4.4)", irls),
        ] {
            let values = vec![Some(before), Some(value), more(value), None];
            rows.push(published::row(name, values));
        }
        let table = Table {
            title: "Errors with wrong points".into(),
            row_header: "method".into(),
            ranking: Ranking::Rows,
            columns: vec![
                Column::named("RMSE, clean points", Metric::Rmse),
                Column::named("RMSE", Metric::Rmse),
                tables::column("more than clean", "%", 1),
                Column::of(Metric::Rel),
            ],
            rows,
        };
        let beside_baselines = Table {
            title: "With wrong points, beside methods without robust losses".into(),
            rows: baselines.into_iter().flatten().collect(),
            ..table.clone()
        };
        section
            .findings
            .extend(beside_baselines.ranking_summary(&robust_name(OURS)));
        section.about.push(
            "Robust rows are fitted to wrong points; their clean error is that of the plain fit."
                .into(),
        );
        section.tables.push(table);
        section.tables.push(self.kinds()?);
        section.tables.push(self.costs()?);
        section.notes = published::notes(&published::NOISE_NOTES);
        self.show(&mut section)?;
        Ok(section)
    }
}

impl NoiseStudy<'_> {
    /// Returns the errors with other kinds of noise.
    fn kinds(&self) -> Result<Table> {
        let labels = OTHERS.iter().map(|(label, ..)| (*label).to_owned());
        compared(
            "RMSE with points that are wrong in other ways",
            labels,
            &self.others,
        )
    }

    /// Returns the errors without noise.
    fn costs(&self) -> Result<Table> {
        let labels = CLEAN.iter().map(|count| format!("{count} points"));
        compared("RMSE without wrong points", labels, &self.untouched)
    }

    fn show(&self, section: &mut Section) -> Result<()> {
        let Some((frame, seed)) = self.noisy.median_frame()? else {
            return Ok(());
        };
        let mut exhibit = self.noisy.exhibit(&frame, seed)?;
        exhibit.predictions.truncate(1);
        for (loss, trial) in &self.robust {
            if [Loss::Irls, OURS].contains(loss) {
                let found = trial.exhibit(&frame, seed)?.predictions;
                let named = found
                    .into_iter()
                    .map(|(_, rmse, d)| (robust_name(*loss), rmse, d));
                exhibit.predictions.extend(named);
            }
        }
        let others = self.noisy.exhibit(&frame, seed)?.predictions.into_iter();
        let is_baseline = |name: &str| BASELINES[..2].iter().any(|method| method.name() == name);
        exhibit
            .predictions
            .extend(others.filter(|(name, ..)| is_baseline(name)));
        let caption = "The frame on which lsdc without a robust loss is neither good nor bad.";
        section.add_figure("frame", caption, Panels::of_example(&exhibit).draw());
        Ok(())
    }
}

/// Returns the errors of each of the compared losses, with a column for each trial.
fn compared(
    title: &str,
    labels: impl Iterator<Item = String>,
    trials: &[Vec<Measured<'_>>],
) -> Result<Table> {
    let row = |(loss, trials): (Option<Loss>, &Vec<Measured<'_>>)| -> Result<Row> {
        let values = trials
            .iter()
            .map(|trial| Ok(Some(trial.first_scores()?[Metric::Rmse])));
        let label = loss.map_or("lsdc".into(), robust_name);
        Ok(tables::row(label, values.collect::<Result<Vec<_>>>()?))
    };
    let rows = COMPARED.into_iter().zip(trials).map(row);
    Ok(Table {
        title: title.into(),
        row_header: "method".into(),
        ranking: Ranking::Rows,
        columns: labels
            .map(|label| Column::named(&label, Metric::Rmse))
            .collect(),
        rows: rows.collect::<Result<_>>()?,
    })
}

fn robust_name(loss: Loss) -> String {
    format!("lsdc, {}", loss.name())
}
