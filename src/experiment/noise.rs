//! Wrong points, with and without robust losses (Fang et al., section 4.4).

use super::benchmark::{RIVALS, all};
use super::cell::{Cell, Measured};
use super::{Lab, Study, published};
use crate::error::Result;
use crate::metrics::{Metric, Scores};
use crate::report::{Column, Contest, Panels, Row, Section, Table};
use crate::sample::{Noise, Pattern};
use lsdc_core::fit::{Loss, Robust};

const POINTS: usize = 1000;
const NOISE: Noise = Noise::Added {
    share: 0.3,
    most: 1.0,
};
/// The loss that stands for `lsdc` beside methods that have none.
const OURS: Loss = Loss::Cauchy;

pub(super) struct NoiseStudy<'a> {
    lab: &'a Lab,
    clean: Measured<'a>,
    noisy: Measured<'a>,
    robust: Vec<(Loss, Measured<'a>)>,
}

impl<'a> NoiseStudy<'a> {
    pub(super) fn new(lab: &'a Lab) -> Self {
        let cell = |name: &str| Measured::new(lab, name).points(Pattern::Exactly(POINTS));
        let robust = |loss: Loss| {
            let cell = cell(&format!("noise-{}", loss.name()))
                .noise(Some(NOISE))
                .fit(|fit| fit.robust = Some(Robust::new(loss)));
            (loss, cell)
        };
        Self {
            lab,
            clean: cell("noise-clean").methods(&all()),
            noisy: cell("noise-none").methods(&all()).noise(Some(NOISE)),
            robust: Loss::ALL.map(robust).into(),
        }
    }
}

impl Study for NoiseStudy<'_> {
    fn cells(&self) -> Vec<&dyn Cell> {
        let mut cells: Vec<&dyn Cell> = vec![&self.clean, &self.noisy];
        cells.extend(self.robust.iter().map(|(_, cell)| cell as &dyn Cell));
        cells
    }

    fn section(&self) -> Result<Section> {
        let mut section = Section::new("noise", "Wrong points, with and without robust losses");
        section
            .about
            .push(format!("{} {POINTS} points, {}.", self.lab.about(), NOISE));
        let clean = self.clean.means()?;
        let noisy = self.noisy.means()?;
        let row = |label: &str, clean: &Scores, noisy: &Scores| {
            let (before, after) = (clean[Metric::Rmse], noisy[Metric::Rmse]);
            Row {
                label: label.to_owned(),
                aside: false,
                values: vec![
                    Some(before),
                    Some(after),
                    Some(100.0 * (after / before - 1.0)),
                    Some(noisy[Metric::Rel]),
                ],
            }
        };
        let mut rows = Vec::new();
        for ((name, clean), (_, noisy)) in clean.iter().zip(&noisy) {
            rows.push(row(name, clean, noisy));
        }
        let mut ours = Vec::new();
        for (loss, cell) in &self.robust {
            ours.push(row(&robust_name(*loss), &clean[0].1, &cell.first()?));
        }
        let mut rivals = vec![ours.iter().find(|r| r.label == robust_name(OURS)).cloned()];
        rivals.extend(rows.iter().skip(1).cloned().map(Some));
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
            rows_are: "method".into(),
            contest: Contest::Rows,
            columns: vec![
                Column::named("RMSE, clean points", Metric::Rmse),
                Column::named("RMSE", Metric::Rmse),
                Column {
                    label: "more than clean".into(),
                    unit: "%",
                    decimals: 1,
                    rising: false,
                },
                Column::of(Metric::Rel),
            ],
            rows,
        };
        let beside_rivals = Table {
            title: "With wrong points, beside methods without robust losses".into(),
            rows: rivals.into_iter().flatten().collect(),
            ..table.clone()
        };
        section
            .findings
            .extend(beside_rivals.verdict(&robust_name(OURS)));
        section.about.push(
            "Robust rows are fitted to wrong points; their clean error is that of the plain fit."
                .into(),
        );
        section.tables.push(table);
        section.notes = published::notes(&published::NOISE_NOTES);
        self.show(&mut section)?;
        Ok(section)
    }
}

impl NoiseStudy<'_> {
    fn show(&self, section: &mut Section) -> Result<()> {
        let Some((frame, seed)) = self.noisy.median_frame()? else {
            return Ok(());
        };
        let mut exhibit = self.noisy.exhibit(&frame, seed)?;
        exhibit.predictions.truncate(1);
        for (loss, cell) in &self.robust {
            if [Loss::Irls, OURS].contains(loss) {
                let found = cell.exhibit(&frame, seed)?.predictions;
                let named = found
                    .into_iter()
                    .map(|(_, rmse, d)| (robust_name(*loss), rmse, d));
                exhibit.predictions.extend(named);
            }
        }
        let others = self.noisy.exhibit(&frame, seed)?.predictions.into_iter();
        let rival = |name: &str| RIVALS[..2].iter().any(|method| method.name() == name);
        exhibit
            .predictions
            .extend(others.filter(|(name, ..)| rival(name)));
        let caption = "The frame on which lsdc without a robust loss is neither good nor bad.";
        section.show("frame", caption, Panels::of_exhibit(&exhibit).draw());
        Ok(())
    }
}

fn robust_name(loss: Loss) -> String {
    format!("lsdc, {}", loss.name())
}
